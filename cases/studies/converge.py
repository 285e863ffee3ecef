"""The convergence study of a scene: every averaged equation, and the simulation."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from time import perf_counter
from typing import Any

from cases.output.summary import plain
from cases.scene.errors import BadInput
from cases.scene.scene import Scene
from cases.studies.answer import FUNCTIONALS, NORMS
from cases.studies.equations import Equation, energy_equation, modal_equation
from cases.studies.ladders import Ladder, degree_ladder, ladders
from cases.studies.weak import SampleSlope, sample_slope, weak_order
from cases.studies.weak_fit import WeakOrder
from fpk.errors import NotApplicable, NotCertified
from fpk.method import Progress, silent
from fpk.observable import observable_name
from fpk.orders import LIMITS

ROUTES = {"nonintegrable": energy_equation, "integrable": modal_equation}
SIMULATION = "montecarlo"
SCHEMES_STUDIED = ("exact_flow", "baoab", "euler_maruyama")
SECONDS = 10.0
"""Processor time that the steps of one scheme may take where the resolution wanted needs more."""


@dataclass(frozen=True)
class Studied:
    """One equation with the reference its errors are measured against, and its ladders."""

    theory: str
    equation: str
    observable: str
    dimension: int
    reference: str
    reference_error: float
    ladders: tuple[Ladder, ...]


@dataclass(frozen=True)
class ConvergenceStudy:
    """All that was measured for a scene; ``refusals`` are routes that do not apply, with reason.

    ``without_contact`` is the p-ladder of (24) of the same system with its contacts taken away: it
    shows whether a kink at the contact energy costs the exponential convergence.
    """

    scene: Scene
    equations: tuple[Studied, ...]
    without_contact: Ladder | None
    schemes: tuple[WeakOrder, ...]
    samples: SampleSlope | None
    refusals: dict[str, str]
    seconds: float

    @property
    def problems(self) -> tuple[str, ...]:
        """Every estimate that is below the true error, in words."""
        return tuple(
            f"{s.equation}, {ladder.name}, {level.label}: the estimate {level.estimate:.2g} is"
            f" below the true L1 error {level.errors['L1']:.2g}"
            for s in self.equations
            for ladder in s.ladders
            for level in ladder.levels
            if not level.honest
        ) + tuple(
            f"without contact, {level.label}: the estimate {level.estimate:.2g} is below the true"
            f" L1 error {level.errors['L1']:.2g}"
            for level in (self.without_contact.levels if self.without_contact else ())
            if not level.honest
        )

    def record(self) -> dict[str, Any]:
        """Return the study as plain data."""
        data = asdict(self)
        data["scene"] = self.scene.name
        for studied, own in zip(data["equations"], self.equations, strict=True):
            for ladder, mine in zip(studied["ladders"], own.ladders, strict=True):
                ladder["name"] = mine.name
        for scheme, mine_too in zip(data["schemes"], self.schemes, strict=True):
            scheme["orders"] = mine_too.ratios
            scheme["errors"], scheme["error_bars"] = mine_too.errors, mine_too.error_bars
        if self.without_contact is not None:
            data["without_contact"]["name"] = self.without_contact.name
        data["limits_of_the_index"] = LIMITS
        found = plain(data)
        assert isinstance(found, dict)
        return found


def chosen_routes(route: str | None, of: str | None) -> tuple[str, ...]:
    """Return the routes asked for by name or by observable; raise ``BadInput`` for another."""
    known = (*ROUTES, SIMULATION)
    if route is not None and route not in known:
        raise BadInput(f"--route {route}: use one of {', '.join(known)}")
    by_name = (route,) if route else known
    if of is None:
        return by_name
    by_observable = {"H": "nonintegrable", "H1,H2": "integrable"}
    if of not in by_observable:
        raise BadInput(f'--of "{of}": use H for (24) or H1,H2 for (17)')
    if by_observable[of] not in by_name:
        raise BadInput(f'--of "{of}": not what --route {route} solves')
    return (by_observable[of],)


def study_convergence(
    scene: Scene,
    routes: Sequence[str],
    *,
    seconds: float = SECONDS,
    seed: int = 1,
    threads: int | None = None,
    progress: Progress = silent,
) -> ConvergenceStudy:
    """Measure how the errors of ``routes`` fall; ``seconds`` is for the steps of each scheme.

    Of several routes those that do not apply are told; one alone raises ``NotApplicable`` or
    ``NotCertified``.
    """
    start = perf_counter()
    equations, refusals = [], {}
    without = None
    for route, make in ROUTES.items():
        if route not in routes:
            continue
        try:
            equations.append(_studied(make(scene.system), progress))
            if route == "nonintegrable" and scene.system.contacts:
                without = degree_ladder(make(replace(scene.system, contacts=())))
        except (NotApplicable, NotCertified) as reason:
            if len(routes) == 1:  # it was asked for, and there is nothing else to show
                raise
            refusals[route] = str(reason)
    schemes: list[WeakOrder] = []
    samples = None
    if SIMULATION in routes:
        try:
            schemes = [
                weak_order(
                    scene.system,
                    name,
                    seconds=seconds,
                    seed=seed,
                    threads=threads,
                    progress=progress,
                )
                for name in SCHEMES_STUDIED
            ]
            samples = sample_slope(scene.system, seed=seed, threads=threads)
        except NotApplicable as reason:
            if len(routes) == 1:
                raise
            refusals[SIMULATION] = str(reason)
    return ConvergenceStudy(
        scene, tuple(equations), without, tuple(schemes), samples, refusals, perf_counter() - start
    )


def _studied(equation: Equation, progress: Progress) -> Studied:
    return Studied(
        theory=equation.theory,
        equation=equation.name,
        observable=observable_name(equation.observable),
        dimension=equation.dimension,
        reference=equation.reference_words,
        reference_error=equation.reference.l1_error,
        ladders=ladders(equation, progress=progress),
    )


COLUMNS = (*NORMS, *FUNCTIONALS)
"""Errors of a level in the order in which tables show them."""
