"""Commands that give one answer by one method: of the stationary state, and of motion in time.

These are ``fpk density``, ``transient``, ``passage``, ``crossings``, ``spectrum``, ``correlation``
and ``relaxation``. Those about the motion of a displacement follow from their records in
``fpk.answer.question``.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial, wraps
from inspect import signature
from time import perf_counter
from typing import TYPE_CHECKING, Any

import click

from cases.command import completed, parts
from cases.scene.errors import BadInput
from fpk.answer.question import QUESTIONS, Question
from fpk.numeric.errors import InvalidInput, NotApplicable

if TYPE_CHECKING:
    from cases.scene.scene import Scene
    from cases.show.records import Record

LIST = '"-1.5:1.5:0.1", "-1,0,0.3"'
AT = click.option("--at", metavar="LIST", required=True, help=f'{LIST}, a pair "A x B".')
TOL = click.option("--tol", type=float, help="Relative error wanted; a solver adapts to meet it.")
SIMULATED = (parts.seed, parts.seconds, parts.threads, parts.dt)
MEMORY = click.option(
    "--memory", type=click.FloatRange(0.0, min_open=True),
    help="GB that a solution of phase-space may need; 4 if left out.",
)  # fmt: skip
START = click.option(
    "--start", metavar="START", default="rest",
    help="rest (the default), H=0.3, H1=0.1,H2=0.2, q1=..,p1=..,.. or noise=0.5.",
)  # fmt: skip


@dataclass(frozen=True)
class Asked:
    """The scene, the method and what the user set for it.

    ``solver`` None: any of the method's. ``tol``: the tolerance of the answer, None for the
    method's own. ``settings``: values of further fields of the method, as its seed, None where the
    user gave none.
    """

    scene: "Scene"
    method: str
    solver: str | None
    tol: float | None
    settings: dict[str, Any]

    def reply(
        self,
        question: Question,
        about: str,
        given: "Record",
        work: Callable[..., Any],
        text: Callable[["Record"], str],
        **settings: Any,
    ) -> None:
        """Print the answer ``work(method, tol=, progress=)``; status 1 where it is not certified.

        ``about`` names this answer in problems. ``given`` are the entries of the record that repeat
        the ``question``, ``text`` the record in words; ``settings`` are further settings of the
        method. Raises ``BadInput`` for a method that does not answer the question or lacks one of
        the settings, or with the first reason why it does not apply.
        """
        from cases.show.records import answer_record, equation_words
        from cases.show.words import reader_words

        start = perf_counter()
        try:
            method, answer, note = self._answer(question, work, {**self.settings, **settings})
        except InvalidInput as error:
            option = error.key.removeprefix("--")
            raise BadInput(f"--{option} {error.value}: {error.remedy}") from None
        seconds = perf_counter() - start
        record = answer_record(self.scene, method, given, answer, seconds, key=question.key)
        failures = record["certificate"]["failures"]
        problems = [f"{about} is not certified: {failure}" for failure in failures]
        record["notes"] = [note] if note else []
        words = map(reader_words, (*record["notes"], *record["averaging_notes"]))
        notes = [f"# {line}" for line in (equation_words(record), *words)]
        parts.end(record, lambda: "\n".join([text(record), *notes]), problems=problems)

    def _answer(
        self, question: Question, work: Callable[..., Any], settings: dict[str, Any]
    ) -> tuple[Any, Any, str]:
        """The first solver of the method that answers, its answer, a note on its tolerance.

        Without ``tol`` the answer is at the default, loosened with the note as in a run.
        """
        from cases.compare.attempts import loosen_tolerance
        from cases.compare.routes import all_routes, methods_of, settings_of
        from cases.show.bar import progress_bar

        name, reasons = self.method, []
        offered = methods_of(name, self.solver, **settings)
        methods = [method for method in offered if hasattr(method, question.name)]
        for setting, value in sorted(settings.items()) if methods else ():
            known = {*settings_of(methods[0]), "partial", "tol"}
            if value not in (None, False) and setting not in known:
                remedy = f"is not an option of {name} by {methods[0].route.solver}; leave it out"
                raise InvalidInput(setting.replace("_", "-"), value, remedy)
        for method in methods:
            try:
                with progress_bar() as progress:
                    ask = partial(work, method, progress=progress)
                    if self.tol is not None:
                        return method, ask(tol=self.tol), ""
                    return method, *loosen_tolerance(ask, lambda p: [p.certificate])
            except NotApplicable as reason:
                reasons.append(str(reason))
        if reasons:
            raise BadInput(f"{self.scene.name}: {name} does not apply: {reasons[0]}")
        able = dict.fromkeys(r.method for r in all_routes() if hasattr(r.make(), question.name))
        raise BadInput(f"{name} gives no {question.words}; use one of {', '.join(able)}")


def asking(*options: Any) -> Callable[[Callable[..., None]], click.Command]:
    """Make a command of ``work``, which takes an ``Asked`` and the ``options`` that it names.

    All other options are settings of the method; scene, method, solver and ``--json`` are added.
    """
    chosen = (
        click.option(
            "--method", required=True, help="One that gives it; others are refused.",
            shell_complete=completed.methods,
        ),
        click.option(
            "--solver", help="One of the solvers of the method.", shell_complete=completed.solvers
        ),
    )  # fmt: skip

    def command_of(work: Callable[..., None]) -> click.Command:
        own = signature(work).parameters

        @wraps(work)
        def command(scene: str, method: str, solver: str | None, **given: Any) -> None:
            tol = given.pop("tol")
            options = {key: given.pop(key) for key in list(given) if key in own}
            loaded = parts.load_checked(scene, tol=tol)
            work(Asked(loaded, method, solver, tol, given), **options)

        every = parts.with_options(parts.scene_name, *chosen, *options, parts.as_json)
        return click.command()(every(command))

    return command_of


def observable_option(words: str) -> Any:
    """Return the option ``--of`` that says in ``words`` what it takes."""
    return click.option(
        "--of", metavar="OBS", required=True, help=words, shell_complete=completed.observables
    )


def _read_points(
    asked: Asked, of: str, at: str, *, displacement: bool = False
) -> tuple[Any, Any, "Record"]:
    """Return the observable, an array of points for each coordinate, and both for the record."""
    observable = parts.observable_of(of, asked.scene)
    from cases.scene.points import parse_points
    from cases.show.records import point_list
    from fpk.answer.names import observable_name

    if displacement and (len(observable) != 1 or observable[0].kind != "q"):
        raise BadInput(f'--of "{of}": use a displacement, q1..q{asked.scene.system.n}')
    points = parse_points(at, len(observable))
    record = {"observable": observable_name(observable), "points": point_list(points)}
    return observable, points, record


@asking(
    observable_option("q1.., p1.., H, H1.. or a pair a,b."), AT, parts.simulation_options, MEMORY
)
def density(asked: Asked, of: str, at: str) -> None:
    """Give one density at the points asked for."""
    observable, points, given = _read_points(asked, of, at)
    from cases.show.records import columns_text
    from fpk.answer.dynamics import Curve
    from fpk.answer.method import Method

    system, settings = asked.scene.system, asked.settings
    parts.check_cluster(settings["cluster"])

    def work(method: Any, tol: float | None, progress: Any) -> Curve:
        loosened = tol is not None and not method.route.sampled and hasattr(method, "tol")
        taken: Method = replace(method, tol=tol) if loosened else method
        plan = taken.planned(system, [observable])
        parts.checkpoint_folder(asked.scene, {**settings, "tol": tol, "observable": of})
        result = taken.solve(system, [observable], plan=plan, progress=progress)
        (p,) = result.densities
        return Curve(*p.at(*points), p.certificate, result.settings, p.error_kind)

    solving = Question("solve", "density", ("observables",), "density")  # all methods do
    own: Any = {"tol": asked.tol, "partial": True}
    asked.reply(solving, of, given, work, columns_text, **own)


@asking(
    click.option("--rates", type=click.IntRange(1, 100), default=5, help="Default 5."), TOL, MEMORY
)
def relaxation(asked: Asked, rates: int) -> None:
    """Give the slowest rates at which the system forgets its past.

    They are the real parts of eigenvalues, beside the imaginary parts, angular frequencies; of a
    conjugate pair one is listed.
    """
    from cases.show.records import rates_text

    def work(method: Any, **how: Any) -> Any:
        return method.relaxation(asked.scene.system, rates, **how)

    asked.reply(QUESTIONS["relaxation"], "relaxation", {}, work, rates_text)


def command_of(name: str) -> click.Command | None:
    """Return the command of a question about a displacement, None where there is none."""
    question = QUESTIONS.get(name)
    if question is None or not question.of_displacement:
        return None

    def curve(asked: Asked, of: str, at: str) -> None:
        observable, points, given = _read_points(asked, of, at, displacement=True)
        from cases.show.records import columns_text
        from fpk.system.modulation import require_constant_noise

        def work(method: Any, **how: Any) -> Any:
            require_constant_noise(asked.scene.system.modulation)
            return getattr(method, name)(asked.scene.system, observable, *points, **how)

        asked.reply(question, f"{name} of {of}", given, work, columns_text)

    curve.__name__, curve.__doc__ = name, question.help
    at = click.option("--at", metavar="LIST", required=True, help=f"{LIST}.")
    return asking(observable_option("A displacement: q1, q2, ..."), at, TOL, *SIMULATED, MEMORY)(
        curve
    )


crossings, spectrum, correlation = map(command_of, ("crossings", "spectrum", "correlation"))


@asking(
    observable_option("H, q1.., p1.., H1.. or a pair a,b."),
    START,
    click.option("--times", metavar="LIST", required=True, help="Times after the start."),
    *(AT, TOL, *SIMULATED),
)
def transient(asked: Asked, of: str, start: str, times: str, at: str) -> None:
    """Give the density of an observable at times after a start."""
    observable, points, given = _read_points(asked, of, at)
    from cases.show.records import columns_text
    from fpk.answer.names import parse_start

    system, later = asked.scene.system, _times(times)
    begin = parts.read("start", start, lambda: parse_start(start, system))
    given = {"observable": given.pop("observable"), "start": str(begin), **given}

    def work(method: Any, **how: Any) -> Any:
        return method.transient(system, observable, begin, later, points, **how)

    asked.reply(QUESTIONS["transient"], f"the density of {of}", given, work, columns_text)


@asking(
    click.option("--limit", metavar="LIMIT", required=True, help="H=1.5, H1=0.4,H2=0.6 or q2=1.2."),
    START,
    click.option("--times", metavar="LIST", help="Times at which the reliability is given."),
    *(TOL, *SIMULATED),
)
def passage(asked: Asked, limit: str, start: str, times: str | None) -> None:
    """Give the first passage of a limit: moments of its time, failure rate, reliability.

    Where it is so rare that a plain simulation sees too few in all the time that it may take,
    montecarlo gives the reliability at the times by multilevel splitting, and no more.
    """
    from cases.compare.rare import passage_answer
    from cases.scene.questions import PassageQuestion, require_below
    from cases.show.records import passage_text
    from fpk.answer.names import parse_limit, parse_start

    system = asked.scene.system
    begin = parts.read("start", start, lambda: parse_start(start, system))
    end = parts.read("limit", limit, lambda: parse_limit(limit, system.n))
    parts.read("start", start, lambda: require_below(system, end, begin))
    question = PassageQuestion(end, begin, tuple(_times(times).tolist()))
    work = partial(passage_answer, system=system, question=question)
    given = {"limit": str(end), "start": str(begin)}
    asked.reply(QUESTIONS["passage"], "first passage", given, work, passage_text)


def _times(text: str | None) -> Any:
    """Return the times that ``text`` lists, none where there is no text."""
    import numpy as np

    from cases.scene.points import parse_points
    from fpk.answer.dynamics import require_times

    if text is None:
        return np.zeros(0)
    (times,) = parse_points(text, 1, option="times")
    return parts.read("times", text, lambda: require_times(times))
