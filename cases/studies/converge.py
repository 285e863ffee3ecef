"""The convergence study of a scene: every averaged equation, and the simulation."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from time import perf_counter
from typing import Any

from cases.output.records import plain
from cases.scene.errors import BadInput
from cases.scene.scene import Scene
from cases.studies.equations import Equation, energy_equation, modal_equation
from cases.studies.ladders import Ladder, degree_ladder, ladders
from cases.studies.weak import SampleSlope, sample_slope, weak_order
from cases.studies.weak_fit import WeakOrder
from fpk.errors import NotApplicable, NotCertified
from fpk.method import Progress, silent
from fpk.observable import observable_name
from fpk.orders import LIMITS
from fpk.system import System
from sim.montecarlo import MonteCarlo

EQUATIONS: dict[str, tuple[str, Callable[[System], Equation]]] = {
    "nonintegrable": ("H", energy_equation),
    "integrable": ("H1,H2", modal_equation),
}
"""For ``--route`` and ``--of``: the theory, the observable that its equation is studied for."""
SIMULATION = MonteCarlo().route.method
SCHEMES_STUDIED = ("exact_flow", "baoab", "euler_maruyama")
SECONDS = 10.0
"""Processor time that the steps of one scheme may take where the resolution wanted needs more."""


@dataclass(frozen=True)
class Studied:
    """One equation with the reference its errors are measured against, and its ladders.

    ``by_tolerance`` says how the route that is given a tolerance discretises.
    """

    theory: str
    equation: str
    observable: str
    dimension: int
    reference: str
    reference_error: float
    by_tolerance: str
    ladders: tuple[Ladder, ...]

    @property
    def in_degree(self) -> Ladder:
        """The ladder in p."""
        return next(ladder for ladder in self.ladders if ladder.family == "p")


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
        pairs = [(s.equation, ladder) for s in self.equations for ladder in s.ladders]
        if self.without_contact is not None:
            pairs.append(("without contact", self.without_contact))
        return tuple(
            f"{where}, {ladder.name}, {level.setting}: the estimate {level.estimate:.2g} is below"
            f" the true L1 error {level.error:.2g}"
            for where, ladder in pairs
            for level in ladder.levels
            if not level.honest
        )

    def record(self) -> dict[str, Any]:
        """Return the study as plain data."""
        record: dict[str, Any] = plain(
            {
                "scene": self.scene.name,
                "equations": [
                    {**vars(s), "ladders": [ladder.record() for ladder in s.ladders]}
                    for s in self.equations
                ],
                "without_contact": self.without_contact and self.without_contact.record(),
                "schemes": [
                    {**asdict(s), "orders": s.ratios, "errors": s.errors,
                     "error_bars": s.error_bars}
                    for s in self.schemes
                ],
                "samples": self.samples and asdict(self.samples),
                "refusals": self.refusals,
                "seconds": self.seconds,
                "limits_of_the_index": LIMITS,
            }
        )  # fmt: skip
        return record


def chosen_routes(route: str | None, of: str | None) -> tuple[str, ...]:
    """Return the routes asked for by name or by observable; raise ``BadInput`` for another."""
    known = (*EQUATIONS, SIMULATION)
    if route is not None and route not in known:
        raise BadInput(f"--route {route}: use one of {', '.join(known)}")
    by_name = (route,) if route else known
    if of is None:
        return by_name
    theory = next((name for name, (observable, _) in EQUATIONS.items() if observable == of), None)
    if theory is None:
        raise BadInput(f'--of "{of}": use H for (24) or H1,H2 for (17)')
    if theory not in by_name:
        raise BadInput(f'--of "{of}": not what --route {route} solves')
    return (theory,)


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

    Of several routes those that do not apply are named with the reason; one alone raises
    ``NotApplicable`` or ``NotCertified``.
    """
    start, system = perf_counter(), scene.system
    equations: list[Studied] = []
    schemes: list[WeakOrder] = []
    without, samples = None, None
    refusals = {}
    for route in routes:
        try:
            if route == SIMULATION:
                schemes = [
                    weak_order(
                        system, name, seconds=seconds, seed=seed, threads=threads, progress=progress
                    )
                    for name in SCHEMES_STUDIED
                ]
                samples = sample_slope(system, seed=seed, threads=threads)
                continue
            _, make = EQUATIONS[route]
            equations.append(_studied(make(system), progress))
            if equations[-1].dimension == 1 and system.contacts:
                without = degree_ladder(make(replace(system, contacts=())))
        except (NotApplicable, NotCertified) as reason:
            if len(routes) == 1:  # it was asked for, and there is nothing else to show
                raise
            refusals[route] = str(reason)
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
        by_tolerance=equation.steered[0].words,
        ladders=ladders(equation, progress=progress),
    )
