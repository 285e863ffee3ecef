"""Convergence: the orders of every averaged equation, of the simulation and of own studies.

An averaged equation is studied in h and p on given meshes and by tolerance, each a ``Study``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from math import isnan
from time import perf_counter
from typing import Any

import numpy as np

from cases.scene.errors import BadInput
from cases.scene.scene import Scene
from cases.scene.units import DIMENSIONS, Units, in_brackets
from cases.show.pictures.panel import Curve, Panel
from cases.show.study_page import Page, Table
from cases.study import OwnStudy
from cases.study.equations import DENSITY_ROUND_OFF, ELEMENTS, EQUATIONS, UNIFORM_WORDS, Equation
from cases.study.levels import Ladder, Study
from cases.study.orders import LIMITS
from cases.study.simulation import (
    ORDERS,
    SECONDS,
    SampleSlope,
    WeakOrder,
    sample_slope,
    weak_order,
)
from fpk.answer.method import Progress, silent
from fpk.numeric.errors import NotApplicable, NotCertified
from sim.montecarlo import MonteCarlo

SCHEMES_STUDIED = ("exact_flow", "baoab", "euler_maruyama")
GCI_WORDS = (
    f"Safety factor 1.25 where the observed order is within 10 % of theory, else 3. {LIMITS}"
)
ORDER_WORDS = (
    "Orders: in h powers of h; in p nats a degree; by tol nats a unit of √unknowns. Levels within"
    " ten times the floor (reference, end of the mesh) give none. Where the nats do not fall"
    " with the degree the error falls exponentially; above contact energies the coefficients have"
    " half-integer powers of H - H_c, and at high degree the rate on a fixed mesh can drop."
)


@dataclass
class ConvergenceStudy:
    """All measured orders of a scene; ``refusals`` are routes that do not apply, with the reason.

    ``name`` is the command and the name of the files. ``equations`` describe the averaged equations
    or the subjects of an own study, each with its ``ladders``; the last ladder of (24) is in p for
    the same system without contacts, which shows whether the kink at the contact energy costs the
    exponential convergence.
    """

    scene: Scene
    equations: list[dict[str, Any]] = field(default_factory=list)
    schemes: list[WeakOrder] = field(default_factory=list)
    samples: SampleSlope | None = None
    refusals: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    name: str = "converge"

    @property
    def ladders(self) -> list[Ladder]:
        """The ladders of all equations."""
        return [ladder for e in self.equations for ladder in e["ladders"]]

    @property
    def problems(self) -> tuple[str, ...]:
        """In words every level whose distance to the reference is NaN or above what is stated."""
        return tuple(
            f"{ladder.equation}, {ladder.name}, {level.settings}: "
            + (
                f"the density is no number: the mesh is too coarse, stated is {level.estimate:.2g}"
                if isnan(level.error)
                else f"the estimate {level.estimate:.2g} is below the true"
                f" {next(iter(ladder.verdicts))} error {level.error:.2g}"
            )
            for ladder in self.ladders
            for level in ladder.levels
            if not level.honest
        )

    def record(self) -> dict[str, Any]:
        """Return the fields for JSON, not yet converted by ``plain``."""
        own = {key: value for key, value in vars(self).items() if key != "name"}
        return {**own, "scene": self.scene.name, "limits_of_the_index": LIMITS}

    def page(self) -> Page:
        """Return the tables and pictures of the command, for the terminal and for files."""
        units, tables = self.scene.units, self._ladder_tables()
        square = units.of(DIMENSIONS["q"], DIMENSIONS["q"])
        time = units.time
        steps = [
            {"scheme": s.scheme, **asdict(run), "step error": error, "its error": bar}
            for s in self.schemes
            for run, error, bar in zip(s.levels, s.errors, s.error_bars, strict=True)
        ]
        listed = ("levels", "errors", "error_bars")
        weak = [{k: v for k, v in vars(s).items() if k not in listed} for s in self.schemes]
        samples, slope, of = list[dict[str, Any]](), "", ""
        if s := self.samples:
            pairs = zip(s.sampled, s.errors, strict=True)
            samples = [{"paths x time": time, "standard error": error} for time, error in pairs]
            of, slope = s.observable, f"slope {s.slope:.3f} ± {s.slope_error:.3f}, theory -0.5"
        step_words = (
            f"Order: of the best fit to all steps; order error: from and to one standard error,"
            f" {ORDERS[0]:g} or {ORDERS[-1]:g} where none is known. Orders: of consecutive resolved"
            " steps, each with its error. Chi²: with the order of theory. Limit: the closed form"
            " where there is one, else the intercept of that fit. Short: by how much the standard"
            " errors are larger than wanted, in the time given. Unstable: no step is stable and"
            " cheap enough."
        )
        tables += [
            Table(
                "steps",
                f"Simulation: errors of the step in {of}",
                steps,
                units={
                    "dt": time,
                    "sampled": time,
                    **dict.fromkeys(("value", "error", "step error", "its error"), square),
                },
            ),
            Table(
                "weak",
                "Simulation: weak order in the step",
                weak,
                (step_words,),
                dict.fromkeys(("limit", "limit_error", "wanted"), square),
            ),
            Table(
                "samples",
                f"Simulation: standard error of {of} in samples",
                samples,
                (slope,),
                {"paths x time": time, "standard error": square},
            ),
            Table(
                "refusals",
                "Routes that do not apply",
                [{"route": route, "reason": why} for route, why in self.refusals.items()],
            ),
        ]
        title = f"{self.name.replace('converge', 'Convergence')}: {self.scene.title}"
        return Page(self.name, self.scene, title, tables, study_panels(self))

    def _ladder_tables(self) -> list[Table]:
        """Return the tables of errors, of observed orders and of Richardson's values."""
        errors, orders, index = (list[dict[str, Any]]() for _ in range(3))
        for x in self.ladders:
            names, finest = {"equation": x.equation, "family": x.name}, x.levels[-1].errors
            for v in x.levels:
                level = {"level": v.settings, "unknowns": v.unknowns, **v.errors}
                errors.append({**names, **level, "estimate": v.estimate})
            orders += [{**names, "error": key, **asdict(of)} for key, of in x.verdicts.items()]
            for key, grid in x.grid.items():
                true = {"functional": key, "true error": finest[key]}
                index.append({**names, **true, **asdict(grid)})
        about = [
            "{equation}: p({observable}) against {reference}, itself within {reference_error:.1e}"
            " in L1. By tolerance: {by_tolerance}".format(**e)
            for e in self.equations
            if "by_tolerance" in e
        ]
        about += [f"{e['equation']}: {e['help']}" for e in self.equations if "help" in e]
        units = self.scene.units
        subject = "Averaged equations" if self.name == "converge" else self.name
        of_errors = {"mean energy": units.quantity("energy")}
        if len(dimensions := {e["dimension"] for e in self.equations}) == 1 and units:
            powers = np.array(DIMENSIONS["H"]) * -dimensions.pop()
            of_errors |= {"L2": units.of(tuple(0.5 * powers)), "max": units.of(tuple(powers))}
            of_errors["integral of p²"] = of_errors["max"]
        return [
            Table("errors", f"{subject}: errors", errors, tuple(about), of_errors),
            Table("orders", f"{subject}: observed orders", orders, (ORDER_WORDS,)),
            Table("index", "Richardson and grid convergence index (GCI)", index, (GCI_WORDS,)),
        ]


def chosen_routes(route: str | None, of: str | None) -> tuple[str, ...]:
    """Return the routes of this name and observable, None: any; raise ``BadInput`` for none."""
    known = {name: observable for name, (_, observable, _) in EQUATIONS.items()}
    known |= {MonteCarlo().route.method: ""}
    chosen = tuple(n for n, o in known.items() if route in (None, n) and of in (None, o))
    if not chosen:
        asked = " ".join(f"--{k} {v}" for k, v in (("route", route), ("of", of)) if v is not None)
        raise BadInput(
            f"{asked}: use --route {', '.join(known)}, or --of H for (24), H1,H2 for (17)"
        )
    return chosen


def study_convergence(
    scene: Scene,
    routes: Sequence[str],
    *,
    seconds: float = SECONDS,
    seed: int = 1,
    threads: int | None = None,
    solver: str = "fem",
    progress: Progress = silent,
) -> ConvergenceStudy:
    """Measure how the errors of ``routes`` fall.

    ``seconds`` of processor time are for the steps of each scheme; ``seed`` and ``threads`` are for
    the simulation. Elements on given meshes and by tolerance are solved by ``solver``, "fem" or
    "scikit-fem". A route among several that does not apply is named with the reason; a single route
    raises ``NotApplicable`` or ``NotCertified``.
    """
    start, system, study = perf_counter(), scene.system, ConvergenceStudy(scene)
    for route in routes:
        try:
            if route not in EQUATIONS:
                method = MonteCarlo(seed=seed, threads=threads)
                for scheme in SCHEMES_STUDIED:
                    own = replace(method, scheme=scheme)
                    study.schemes.append(weak_order(system, own, seconds=seconds))
                    progress(len(study.schemes), len(SCHEMES_STUDIED), f"steps of {scheme}")
                study.samples = sample_slope(system, method)
                continue
            *_, make = EQUATIONS[route]
            equation = make(system, solver)
            measured = list(ladders(families(equation), equation.name, progress=progress))
            if equation.dimension == 1 and system.contacts:
                try:
                    free = make(replace(system, contacts=()), solver)
                    free = replace(free, name=f"{free.name} without contact")
                    measured.append(free.study(free.degrees()).ladder())
                except (NotApplicable, NotCertified) as reason:  # stops may be what makes it stable
                    study.refusals[f"{route} without contact"] = str(reason)
            study.equations.append(
                {
                    "theory": route,
                    "equation": equation.name,
                    "observable": equation.reference.name,
                    "dimension": equation.dimension,
                    "reference": equation.reference_words,
                    "reference_error": equation.reference.l1_error,
                    "by_tolerance": UNIFORM_WORDS if solver == "scikit-fem" else equation.words,
                    "ladders": measured,
                }
            )
        except (NotApplicable, NotCertified) as reason:
            if len(routes) == 1:  # it was asked for, and there is nothing else to show
                raise
            study.refusals[route] = str(reason)
    study.seconds = perf_counter() - start
    return study


def study_own(
    own: OwnStudy, scene: Scene, *, seed: int = 1, progress: Progress = silent
) -> ConvergenceStudy:
    """Measure every study of ``own``, grouped by ``equation``; ``seed`` is for simulations.

    Raises what ``own.studies`` and the solvers raise.
    """
    start, studies, subjects = perf_counter(), own.studies(scene, seed), dict[str, dict[str, Any]]()
    for study, ladder in zip(studies, ladders(studies, own.name, progress=progress), strict=True):
        new = {
            "theory": own.name,
            "equation": study.equation,
            "dimension": study.dimension,
            "help": own.help,
            "ladders": [],
        }
        subjects.setdefault(study.equation, new)["ladders"].append(ladder)
    result = ConvergenceStudy(scene, [*subjects.values()], name=own.name)
    result.seconds = perf_counter() - start
    return result


def families(equation: Equation) -> list[Study]:
    """Return studies in h of three degrees, one in p, one by tolerance of the route by elements."""
    route = next(iter(equation.by_tolerance))
    by_degree = map(equation.elements, [*ELEMENTS[equation.dimension]][:3])
    first = [*by_degree, equation.degrees(), equation.to_tolerance(route)]
    return [equation.study(each) for each in first]


def ladders(
    studies: Sequence[Study], name: str, *, progress: Progress = silent
) -> Iterator[Ladder]:
    """Yield the measured ladder of every study; ``progress`` shows "convergence of ``name``"."""
    for k, study in enumerate(studies, start=1):
        yield study.ladder()
        progress(k, len(studies), f"convergence of {name}")


def study_panels(study: ConvergenceStudy) -> list[Panel]:
    """Return errors against unknowns and, in p, against the degree; the bias against the step.

    Dashed lines have the slope of theory, below the finest levels.
    """
    panels = []
    for e in study.equations:
        name, own = e["equation"], [x for x in e["ladders"] if x.equation == e["equation"]]
        key = next(iter(own[0].verdicts))
        axis: dict[str, Any] = {"limits": (1e-16, 10.0)}
        y = f"{key} error"
        if "observable" in e:
            y = f"L₁ error of p({e['observable']})"
            axis["floor"] = e["reference_error"] + DENSITY_ROUND_OFF
        curves = [_in_unknowns(ladder, key) for ladder in own]
        panels.append(Panel(f"{name}; dashed: order of theory", "unknowns N", y, curves, **axis))
        in_degree = [x for x in e["ladders"] if x.family == "p" and e["dimension"] == 1]
        curves = []
        for ladder in in_degree:
            degrees = [-np.log(level.size) for level in ladder.levels]
            label = f"{ladder.equation}: exp(−{ladder.verdicts[key].order:.1f} p)"
            curves.append(Curve(label, degrees, [level.errors[key] for level in ladder.levels]))
        if in_degree:
            x, axis["logarithmic"] = "degree p on a fixed mesh", False
            panels.append(Panel("exponential in p", x, y, curves, **axis))
    return [*panels, _step_panel(study.schemes, study.scene.units)] if study.schemes else panels


def _in_unknowns(ladder: Ladder, key: str) -> Curve:
    """Return the curve of error ``key`` over the unknowns; dashed: the order of theory, if any."""
    N = np.array([level.unknowns for level in ladder.levels], dtype=float)
    e = np.array([level.errors[key] for level in ladder.levels])
    notes, verdict = [level.settings for level in ladder.levels], ladder.verdicts[key]
    if verdict.theory is None:
        return Curve(ladder.name, N, e, notes=notes)
    dashed = N[-3:], 0.5 * e[-1] * (N[-3:] / N[-1]) ** -(verdict.theory / ladder.dimension)
    return Curve(f"{ladder.name}: order {verdict.order:.2f}", N, e, dashed=dashed, notes=notes)


def _step_panel(schemes: Sequence[WeakOrder], units: Units) -> Panel:
    curves = []
    for s in schemes:
        dt, words = np.array([level.dt for level in s.levels]), f"{s.verdict} (theory {s.theory})"
        if s.verdict in ("as theory", "pre-asymptotic") and not s.beyond:
            words = f"order {s.order:.1f} ± {np.ptp(s.order_error) / 2:.1f} (theory {s.theory})"
        line = (dt, abs(s.slope) * dt**s.theory) if dt.size else None
        label, bar = f"{s.scheme}: {words}", np.array(s.error_bars)
        curves.append(Curve(label, dt, s.errors, bar, dashed=line, style="none"))
    x = f"step dt [{units.time}]" if units else "step dt, in the scene's unit of time"
    square = units.of(DIMENSIONS["q"], DIMENSIONS["q"])
    y = f"step error of {schemes[0].observable}{in_brackets(square)}"
    return Panel("full system (6), simulation; lines: theory", x, y, curves)
