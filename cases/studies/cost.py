"""The work-precision study of a scene: what each digit costs, by every route."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from averaging.integrable import Integrable
from averaging.nonintegrable import NonIntegrable
from cases.comparison.compare import BINS_1D
from cases.output.summary import plain
from cases.scene.scene import Scene
from cases.studies.deterministic import Candidate, candidates, priced
from cases.studies.equations import Changed, energy_equation, modal_equation, unchanged
from cases.studies.full_system import REFERENCE_RELAXATIONS, FullReference, full_reference
from cases.studies.priced import (
    Cheapest,
    Crossover,
    NotTimed,
    Priced,
    crossovers,
    price_list,
    promised_list,
)
from cases.studies.sampled import full_routes
from cases.studies.sampled_energy import averaged_route
from cases.studies.sampling_law import FULL, Law
from cases.studies.timing import timed_first, timing
from cases.studies.weak import observed_mass
from fpk.density import Density
from fpk.errors import NotApplicable, NotCertified
from fpk.method import Method, Progress, silent
from fpk.observable import observable_name, parse_observable

DIGITS = tuple(range(1, 11))


@dataclass(frozen=True)
class Model:
    """An averaged theory as an answer to the full system: averaging error, never numerical.

    ``distance`` is L1 of p(q_i) to the full system, known to ``error``.
    """

    theory: str
    observable: str
    distance: float
    error: float
    seconds: float


@dataclass(frozen=True)
class CostStudy:
    """Priced routes, those not timed and why, the price list and where routes cross."""

    scene: Scene
    routes: tuple[Priced, ...]
    not_timed: tuple[NotTimed, ...]
    laws: tuple[Law, ...]
    models: tuple[Model, ...]
    floors: dict[str, float]
    full_reference: str
    prices: tuple[Cheapest, ...]
    promises: tuple[Cheapest, ...]
    crossings: tuple[Crossover, ...]
    seconds: float

    @property
    def problems(self) -> tuple[str, ...]:
        """Routes whose answer disagrees with the reference; those without an answer are told.

        So are baselines: that one of them has no usable step says nothing against the answers.
        """
        return tuple(
            f"{n.route} of {n.equation} ({n.settings}) is not timed: it differs by"
            f" L1 = {n.distance:.3g}, stated is {n.allowed:.3g}"
            for n in self.not_timed
            if n.distance == n.distance and not n.baseline
        )

    def record(self) -> dict[str, Any]:
        """Return the study as plain data."""
        data = asdict(self)
        data["scene"] = self.scene.name
        data["problems"] = self.problems
        found = plain(data)
        assert isinstance(found, dict)
        return found


def study_cost(
    scene: Scene,
    *,
    changed: Changed = unchanged,
    injected: Sequence[Candidate] = (),
    simulate: bool = True,
    seed: int = 1,
    relaxations: float = REFERENCE_RELAXATIONS,
    progress: Progress = silent,
) -> CostStudy:
    """Check and time every route of ``scene``, then price the digits.

    ``changed`` and ``injected`` put wrong processes and routes in: the study must catch them.
    """
    start, system = perf_counter(), scene.system
    good: list[Priced] = []
    bad: list[NotTimed] = []
    floors: dict[str, float] = {}
    nan = float("nan")
    try:
        energy = energy_equation(system, changed=changed)
        floors[energy.name] = energy.reference.l1_error
        found = priced(energy, [*candidates(energy), *injected], progress=progress)
        good += found[0]
        bad += found[1]
        if simulate:
            sampled = averaged_route(system, energy, seed=seed, progress=progress)
            (good if isinstance(sampled, Priced) else bad).append(sampled)  # type: ignore[arg-type]
    except (NotApplicable, NotCertified) as reason:
        bad.append(NotTimed("all", "averaged equation (24)", "", nan, nan, str(reason)))
    try:
        modal = modal_equation(system)
        floors[modal.name] = modal.reference.l1_error
        found = priced(modal, candidates(modal), progress=progress)
        good += found[0]
        bad += found[1]
    except (NotApplicable, NotCertified) as reason:
        bad.append(NotTimed("all", "averaged equation (17)", "", nan, nan, str(reason)))
    laws: list[Law] = []
    models: list[Model] = []
    words = "not simulated"
    if simulate:
        observable = parse_observable(f"q{observed_mass(system) + 1}", system.n)
        try:
            reference = full_reference(system, observable, seed=seed, relaxations=relaxations)
            words = reference.words
            floors[FULL] = reference.error
            more, not_timed, laws = full_routes(
                system, observable, reference, seed=seed, progress=progress
            )
            good += more
            bad += not_timed
            models = _models(scene, reference)
        except NotApplicable as reason:
            bad.append(NotTimed("all", FULL, "", nan, nan, str(reason)))
    return CostStudy(
        scene=scene,
        routes=tuple(good),
        not_timed=tuple(bad),
        laws=tuple(laws),
        models=tuple(models),
        floors=floors,
        full_reference=words,
        prices=price_list(good, DIGITS),
        promises=promised_list(good, DIGITS),
        crossings=crossovers(good),
        seconds=perf_counter() - start,
    )


def _models(scene: Scene, reference: FullReference) -> list[Model]:
    """Averaging error of each theory in p(q_i), and the time of its closed form."""
    system = scene.system
    observable = parse_observable(f"q{observed_mass(system) + 1}", system.n)
    theories: tuple[Method, ...] = (NonIntegrable("closed-form"), Integrable("closed-form"))
    found = []
    for method in theories:
        if method.refusal(system, observable) is not None:
            continue
        work = partial(method.solve, system, [observable])
        result, first = timed_first(work)
        (density,) = result.densities
        assert isinstance(density, Density)
        nodes = density.panels[0]
        edges = np.linspace(nodes[0], nodes[-1], BINS_1D + 1)
        mine = density.cell_averages(edges) * np.diff(edges)
        distance = float(np.sum(np.abs(mine - reference.shares(edges))))
        found.append(
            Model(
                method.name,
                observable_name(observable),
                distance,
                reference.error + density.l1_error,
                timing(work, first).seconds,
            )
        )
    return found
