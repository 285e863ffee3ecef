"""Questions about motion in time: one record for each, from which methods and commands follow.

A ``Question`` has the name of the method's function that answers it. A class defines this function,
of the method and an ``Asked``, in its body or afterwards::

    class Linear(Method):
        @answer
        def spectrum(self, asked: Asked) -> Curve: ...

    Linear.spectrum = answer(spectrum)
    Linear().spectrum(system, parse_observable("q1", 1), np.linspace(0.0, 2.0, 5), tol=1e-8)

``tol`` is the largest allowed error: for curves in units of ``scale``, for rates relative to each.
Spectra are two-sided, in angular frequency: S(ω) = (1/2π) ∫ C(t) e^(−iωt) dt, ∫ S dω over all real
ω is the variance; C(t) = E q(0) q(t) − (E q)², t >= 0. ``InvalidInput`` is raised here for a
tolerance that is not > 0, an observable that is no displacement, or a negative or infinite lag, and
by methods for a start at or beyond the limit, or times that do not ascend from 0 or later.
``NotApplicable`` is raised by a method that has no answer for the system, observable, limit or
start. This file imports no numerical library: the command line imports it for its help.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from inspect import Parameter, Signature
from math import inf, pi
from typing import TYPE_CHECKING, Any, TypeVar

from fpk.answer.names import Observable, displacement_row
from fpk.numeric.errors import InvalidInput

if TYPE_CHECKING:
    from fpk.system.system import System

Answer = TypeVar("Answer")
Progress = Callable[[int, int, str], None]
"""Called as ``progress(done, total, what)``: ``done`` of ``total`` parts of the work ``what``."""
Powers = tuple[int, int, int]
"""Exponents of length, mass and time in a unit."""


def silent(done: int, total: int, what: str) -> None:
    """Ignore the progress of ``what``, ``done`` of ``total`` parts."""


@dataclass(frozen=True, eq=False)
class Asked:
    """Arguments of one question as a method receives them; ``Question.takes`` names the fields set.

    ``tol`` is the largest allowed error, None for the method's default. ``at`` are levels, angular
    frequencies or lags (points,), or for densities the points, one array (points,) for each
    coordinate. ``start`` is a ``fpk.answer.names.Start``, ``limit`` a
    ``fpk.answer.names.Limit``; ``times`` (times,) count from the start; ``count`` is the number of
    relaxation rates.
    """

    system: "System"
    tol: Any
    progress: Progress
    observable: Observable = ()
    at: Any = None
    start: Any = None
    limit: Any = None
    times: Any = None
    count: int = 0

    @property
    def row(self) -> int:
        """Number, from 0, of the mass whose displacement is observed; else ``InvalidInput``."""
        return displacement_row(self.observable)


@dataclass(frozen=True, eq=False)
class Question:
    """A question: the methods' function and the command that answer it have its ``name``.

    ``words`` name the answer, as in "exact gives no spectrum"; ``takes`` are the fields of
    ``Asked`` in the order of arguments; ``key`` names the values in records. The other fields are
    for curves of one displacement: ``help`` is the help of the command; ``axis`` names the quantity
    ``at``, empty for levels; ``powers`` are the units of ``at`` and of the values;
    ``scale(σ_q, σ_v)`` is a natural size of the values, σ standard deviations; ``check(at)`` raises
    ``InvalidInput`` for points without an answer.
    """

    name: str
    words: str
    takes: tuple[str, ...] = ("observable", "at")
    key: str = ""
    help: str = ""
    axis: str = ""
    powers: tuple[Powers, Powers] = ((0, 0, 0), (0, 0, 0))
    scale: Callable[[float, float], float] = lambda q, v: 1.0
    check: Callable[[Any], None] = lambda at: None

    @property
    def of_displacement(self) -> bool:
        """Whether the answer is a stationary curve of one displacement."""
        return self.takes == ("observable", "at")


def require_lags(at: Any) -> None:
    """Raise ``InvalidInput`` unless all lags ``at`` are finite and >= 0."""
    wrong = at[~((at >= 0.0) & (at < inf))]
    if wrong.size:
        raise InvalidInput("at", float(wrong[0]), "a lag is a time, finite and 0 or later")


QUESTIONS: dict[str, Question] = {}
"""Every question by its name, in the order of registration."""


def register_question(question: Question) -> Question:
    """Add ``question`` to the registry and return it; raise ``ValueError`` if its name is taken."""
    if question.name in QUESTIONS:
        raise ValueError(f"the question {question.name} is registered already")
    QUESTIONS[question.name] = question
    return question


def answer(function: Callable[[Any, Asked], Answer]) -> Callable[..., Answer]:
    """Return ``function(method, asked)`` as a method that takes the arguments of the question.

    The question has the name of ``function``; its arguments follow the system, then ``tol`` and
    ``progress`` by keyword. Before the call ``InvalidInput`` is raised unless ``tol`` is > 0 or
    None; for a curve of one displacement also for another observable or points without an answer,
    and ``NotApplicable`` if the method refuses the system or the observable.
    """
    question, given = QUESTIONS[function.__name__], Parameter.POSITIONAL_OR_KEYWORD
    parameters = [Parameter(name, given) for name in ("self", "system", *question.takes)]
    for name, value in (("tol", None), ("progress", silent)):
        parameters.append(Parameter(name, Parameter.KEYWORD_ONLY, default=value))
    signature = Signature(parameters)

    @wraps(function)
    def ask(*given: Any, **named: Any) -> Answer:
        from fpk.answer.certificate import tolerance  # noqa: PLC0415  (see above)

        bound = signature.bind(*given, **named)
        bound.apply_defaults()
        method, asked = bound.arguments.pop("self"), Asked(**bound.arguments)
        tolerance(asked.tol, None)
        if question.of_displacement:
            displacement_row(asked.observable)
            question.check(asked.at)
            method.planned(asked.system, [asked.observable])
        return function(method, asked)

    ask.__signature__ = signature  # type: ignore[attr-defined]
    return ask


for _question in (
    Question(
        name="crossings",
        words="crossings",
        key="rate",
        help="""Give the upcrossings of levels per unit time in the stationary state.

        By linear, exact, phase-space or the averaged theories (nonintegrable, integrable), or
        counted in a simulation by montecarlo.
        """,
        powers=((1, 0, 0), (0, 0, -1)),
        scale=lambda q, v: v / (2.0 * pi * q),
    ),
    Question(
        name="spectrum",
        words="spectrum",
        key="spectrum",
        help="""Give the power spectral density at angular frequencies.

        It is two-sided: its integral over all frequencies, negative ones too, is the variance. By
        linear or phase-space, or estimated from a simulation by montecarlo.
        """,
        axis="angular frequency",
        powers=((0, 0, -1), (2, 0, 1)),
        scale=lambda q, v: q**3 / v,
    ),
    Question(
        name="correlation",
        words="correlation",
        key="correlation",
        help="""Give the autocovariance E q(0) q(t) − (E q)² at lags t >= 0.

        It begins with the variance. By linear or phase-space, or estimated from a simulation by
        montecarlo.
        """,
        axis="lag",
        powers=((0, 0, 1), (2, 0, 0)),
        scale=lambda q, v: q**2,
        check=require_lags,
    ),
    Question("relaxation", "relaxation rates", ("count",)),
    Question("transient", "densities in time", ("observable", "start", "times", "at"), "density"),
    Question("passage", "first passage", ("limit", "start", "times")),
):
    register_question(_question)
