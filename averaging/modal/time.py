"""Modal energies in time: transient densities, relaxation rates, first passage, Eqs. (17), (33).

Uncoupled energies of constant damping are independent square-root processes, in closed form; two
energies, coupled or not, are solved for by finite elements.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import prod

import numpy as np

from averaging.modal import square_root_process as cir
from averaging.modal.analysis import ModalAnalysis
from averaging.modal.groups import unsolved
from fpk.arrays import Array
from fpk.certificate import Measured, certify
from fpk.density import SMALLEST
from fpk.dynamics import Rates
from fpk.errors import InvalidInput, NotApplicable
from fpk.evolution import Number, Passage, Transient
from fpk.limit import Limit
from fpk.observable import Observable, observable_name
from fpk.plane.stationary import solve_plane
from fpk.plane.time.levels import Frame
from fpk.plane.time.passage import PlaneLimit, first_passage
from fpk.plane.time.relaxation import relaxation_rates
from fpk.plane.time.start import DensityStart, PointStart
from fpk.plane.time.start import Start as PlaneStart
from fpk.plane.time.transient import transient_densities
from fpk.plane.time.view import View
from fpk.process import Process
from fpk.quadrature import panel_rule
from fpk.start import Start
from fpk.system import System

TOL = 1e-8
"""Error wanted where none is named."""
STATIONARY_TOL = (1e-2, 1e-11)
"""Share of the tolerance to which the stationary density is computed, and the least such."""
EQUAL = 1e-12
"""Relative difference of decay or temperature, beyond round-off, up to which modes are alike."""
REACH = 7.0
"""Standard deviations of the amplitude over which the mass of a closed form is measured: e^−49."""
SUM_PANELS, SUM_POINTS = 16, (20, 24)
"""Panels and Gauss points of each along H1 + H2 = H: answer and error."""
DECAY_PANELS, DECAY_POINTS = 80, (14, 18)
"""Panels, equidistant in ln t, and Gauss points of each of ∫ P(T > t) dt: answer and error."""
SETTLED = 40.0
"""Exponent at which a mode of the reliability is negligible: e^−40."""


@dataclass(frozen=True, eq=False)
class _Beginning:
    """Modal energies (n,) at the start, or the factor on the noise under which it is stationary."""

    energies: Array
    factor: float | None = None


def _beginning(system: System, modes: ModalAnalysis, start: Start) -> _Beginning:
    n, name = system.n, str(start)
    if start.kind == "noise":
        factor = start.values["noise"]
        return _Beginning(np.zeros(n), factor if factor > 0.0 else None)
    if start.kind == "modal":
        return _Beginning(np.array([start.values[f"H{i + 1}"] for i in range(n)]))
    if start.kind == "energy":
        if n == 1 or start.rest:
            return _Beginning(np.full(n, start.values["H"]))
        raise NotApplicable(
            f"{name}: give every modal energy, H1=..,H2=..: their sum is not enough"
        )
    q, p = start.state(n)
    T, omega = modes.mode_shapes, modes.natural_frequency
    Q, P = T.T @ (system.mass * q), T.T @ p
    return _Beginning(0.5 * (P**2 + (omega * Q) ** 2))


def require_times(times: Array, *, positive: bool = False) -> None:
    """Raise ``InvalidInput`` for times that do not ascend from 0 or later; 0 if ``positive``."""
    if times.size and (
        not np.all(np.isfinite(times)) or np.any(np.diff(times) < 0.0) or times[0] < 0.0
    ):
        raise InvalidInput("times", times, "must ascend from 0 or later")
    if positive and times.size and times[0] == 0.0:
        raise InvalidInput("times", 0.0, "must be > 0: at the start the density is a point's")


def modal_transient(
    system: System,
    modes: ModalAnalysis,
    solver: str,
    observable: Observable,
    start: Start,
    times: Array,
    at: tuple[Array, ...],
    *,
    tol: float | None,
) -> Transient:
    """Return the densities of modal energies, or of their sum, as ``Transients`` says.

    Raises ``NotApplicable`` for displacements and momenta, and for what the solver does not give.
    """
    require_times(times, positive=True)
    name = observable_name(observable)
    if any(c.kind != "H" for c in observable) or (
        len(observable) > 1 and any(c.index is None for c in observable)
    ):
        raise NotApplicable(
            f"{name}: in time only modal energies H1, H2, …, two of them, or their sum H"
        )
    beginning, wanted = _beginning(system, modes, start), tol or TOL
    if solver == "closed-form":
        return _closed_transient(modes, observable, beginning, times, at, wanted)
    rows = [c.row for c in observable if c.index is not None]
    pair = _pair(modes, rows or range(modes.n))
    frame = _frame(modes.process(pair), wanted)
    at = tuple(np.asarray(x, float) for x in at)
    if rows == pair[::-1]:
        at = at[::-1]
    view = View(
        "sum"
        if not rows
        else "pair"
        if len(rows) == 2
        else ("first", "second")[pair.index(rows[0])]
    )
    theta, decay = modes.temperature[pair], 2.0 * modes.half_bandwidth[pair]
    energies = beginning.energies[pair]

    def by_modes(t: float, *H: Array) -> Array:
        spread = theta * -np.expm1(-decay * t)
        each = spread[rows and [pair.index(r) for r in sorted(rows)]] if rows else [spread.min()]
        reach = sum(np.abs(x) / s for x, s in zip(H, each, strict=True))
        return np.asarray(2.0 * modes.relative_error * (1.0 + reach + np.sum(energies / spread)))

    first = _plane_start(modes, pair, beginning, wanted)
    return transient_densities(
        frame, first, view, times, at, tol=wanted, coefficients_error=by_modes
    )


def _pair(modes: ModalAnalysis, rows: Sequence[int]) -> list[int]:
    """The two modes to solve for together, on which no other acts."""
    if reason := unsolved(modes, "fem"):
        raise NotApplicable(reason)
    behind = {m for group in modes.averaged.groups if set(group) & set(rows) for m in group}
    alone = [g[0] for g in modes.averaged.groups if len(g) == 1 and g[0] not in behind]
    pair = sorted([*behind, *alone[: max(0, 2 - len(behind))]])
    if len(pair) != 2:
        raise NotApplicable(
            f"{len(pair)} energies would have to be solved for together; fem takes two"
        )
    return pair


def _frame(process: Process, tol: float) -> Frame:
    share, least = STATIONARY_TOL
    return Frame(process, solve_plane(process, tol=max(share * tol, least)))


def _plane_start(
    modes: ModalAnalysis, pair: list[int], beginning: _Beginning, tol: float
) -> PlaneStart:
    if beginning.factor is None:
        return PointStart(beginning.energies[pair])
    factor, present = beginning.factor, modes.process(pair)
    quiet = modes.noise[pair]

    def louder(energies: Array):  # type: ignore[no-untyped-def]
        c = present.coefficients(energies)
        more = (factor - 1.0) * quiet
        return c._replace(
            drift=c.drift + more, diffusion=factor * c.diffusion, divergence=factor * c.divergence
        )

    scales = tuple(factor * s for s in present.energy_scales)
    density = solve_plane(Process(louder, scales), tol=_frame_tol(tol))
    return DensityStart(density, factor)


def _frame_tol(tol: float) -> float:
    return max(STATIONARY_TOL[0] * tol, STATIONARY_TOL[1])


def _require_constant(modes: ModalAnalysis) -> None:
    if not modes.constant:
        raise NotApplicable("damping that depends on the state has no closed form in time; use fem")


def _mode_density(
    modes: ModalAnalysis, m: int, beginning: _Beginning, t: float
) -> Callable[[Array], tuple[Array, Array]]:
    """The density of one modal energy and its error, that of decay and noise included."""
    theta, c = float(modes.temperature[m]), 2.0 * float(modes.half_bandwidth[m])
    relative = modes.relative_error
    if beginning.factor is None:
        x0, tau = float(beginning.energies[m]) / theta, float(-np.expm1(-c * t))
    else:
        x0, tau = 0.0, cir.exponential_mean(beginning.factor, c * t)

    def density(H: Array) -> tuple[Array, Array]:
        x = H / theta
        if beginning.factor is None:
            p, error = cir.transition_density(x, x0, c * t)
        else:
            p = np.where(x >= 0.0, np.exp(-np.maximum(x, 0.0) / tau) / tau, 0.0)
            error = cir.ROUNDING * (1.0 + np.abs(x) / tau) * p
        return p / theta, (error + 2.0 * relative * (1.0 + (np.abs(x) + x0) / tau) * p) / theta

    return density


def _mass(modes: ModalAnalysis, m: int, beginning: _Beginning, t: float) -> tuple[float, float]:
    """∫p and ∫ error of one mode, over the amplitude √H."""
    theta, c = float(modes.temperature[m]), 2.0 * float(modes.half_bandwidth[m])
    if beginning.factor is None:
        width = np.sqrt(-theta * np.expm1(-c * t))
        middle = np.sqrt(float(beginning.energies[m]) * np.exp(-c * t))
    else:
        width, middle = np.sqrt(theta * cir.exponential_mean(beginning.factor, c * t)), 0.0
    r, w = panel_rule(np.linspace(max(0.0, middle - REACH * width), middle + REACH * width, 17), 20)
    p, error = _mode_density(modes, m, beginning, t)(r**2)
    return float(np.sum(2.0 * w * r * p)), float(np.sum(2.0 * w * r * error))


def _closed_transient(
    modes: ModalAnalysis,
    observable: Observable,
    beginning: _Beginning,
    times: Array,
    at: tuple[Array, ...],
    tol: float,
) -> Transient:
    """Products of the transition densities; of the sum of two energies a convolution."""
    _require_constant(modes)
    rows = [c.row for c in observable if c.index is not None]
    if not rows and modes.n > 2:
        raise NotApplicable("the sum of more than two modal energies in time is not given")
    behind = rows or list(range(modes.n))
    values, errors = np.empty((2, times.size, at[0].size))
    l1 = defect = 0.0
    for k, t in enumerate(times):
        parts = [_mode_density(modes, m, beginning, float(t)) for m in behind]
        if rows or modes.n == 1:
            p, e = zip(*(part(x) for part, x in zip(parts, at, strict=True)), strict=True)
            values[k] = prod(p)
            errors[k] = sum(e[i] * prod(p[:i] + p[i + 1 :]) for i in range(len(p)))
        else:
            values[k], errors[k] = _convolved(parts, at[0])
        masses = [_mass(modes, m, beginning, float(t)) for m in behind]
        l1 = max(l1, sum(e for _, e in masses))
        defect = max(defect, abs(prod(m for m, _ in masses) - 1.0))
    highest = float(np.max(errors / np.max(values, axis=1, initial=SMALLEST, keepdims=True)))
    measured = Measured(
        l1_error=float(np.max([l1 + defect, highest])),
        mass_defect=defect,
        minimum=min(0.0, float(values.min(initial=0.0))),
        residual=0.0,
        tail_mass=float(np.exp(-(REACH**2))),
    )
    return Transient(times, values, errors + SMALLEST, "numerical", certify(measured, tol=tol))


def _convolved(
    parts: Sequence[Callable[[Array], tuple[Array, Array]]], energy: Array
) -> tuple[Array, Array]:
    """∫p_1(x) p_2(H − x) dx, and its error, panels graded to both ends."""
    H = np.maximum(energy, 0.0)[:, None]
    nodes = np.sin(np.linspace(0.0, 0.5 * np.pi, SUM_PANELS + 1)) ** 2
    totals = []
    for points in SUM_POINTS:
        s, w = (a.ravel() for a in panel_rule(nodes, points))
        (p, p_error), (r, r_error) = parts[0](H * s), parts[1](H * (1.0 - s))
        totals.append((H[:, 0] * ((p * r) @ w), H[:, 0] * ((p * r_error + p_error * r) @ w)))
    (coarse, _), (fine, own) = totals
    return fine, own + np.abs(fine - coarse)


def modal_passage(
    system: System,
    modes: ModalAnalysis,
    solver: str,
    limit: Limit,
    start: Start,
    times: Array,
    *,
    tol: float | None,
) -> Passage:
    """Return the first passage of modal energies or their sum, as ``Passages`` says.

    Raises ``NotApplicable`` for limits of displacements, and for what the solver does not give.
    """
    require_times(times)
    if limit.kind == "q":
        raise NotApplicable(f"{limit}: averaged modal energies know no displacement; use H, H1, …")
    beginning, wanted = _beginning(system, modes, start), tol or TOL
    if limit.kind == "H":
        limits = {}
        beyond = beginning.energies.sum() >= limit.value
    else:
        limits = {int(name[1:]) - 1: a for name, a in limit.values.items()}
        beyond = any(beginning.energies[m] >= a for m, a in limits.items())
    if beyond:
        raise InvalidInput("start", str(start), f"is at or beyond the limit {limit}")
    if solver == "closed-form":
        return _closed_passage(modes, limit, limits, beginning, times, wanted)
    pair = _pair(modes, list(limits) or range(modes.n))
    of_pair = [limits.get(m) for m in pair]
    plane = PlaneLimit(total=limit.value) if not limits else PlaneLimit(of_pair[0], of_pair[1])
    first = _plane_start(modes, pair, beginning, wanted)
    frame = _frame(modes.process(pair), wanted)
    return first_passage(
        frame, first, plane, times, tol=wanted, coefficients_error=modes.relative_error
    )


def _closed_passage(
    modes: ModalAnalysis,
    limit: Limit,
    limits: dict[int, float],
    beginning: _Beginning,
    times: Array,
    tol: float,
) -> Passage:
    _require_constant(modes)
    if beginning.factor is not None:
        raise NotApplicable(
            "a start that is stationary under other noise has no closed form; use fem"
        )
    theta, c = modes.temperature, 2.0 * modes.half_bandwidth
    if limits:
        parts = [
            (a / theta[m], beginning.energies[m] / theta[m], 1.0, float(c[m]))
            for m, a in limits.items()
        ]
    else:
        alike = EQUAL + 4.0 * modes.relative_error
        if np.ptp(theta) > alike * theta[0] or np.ptp(c) > alike * c[0]:
            raise NotApplicable(
                "of modes of unequal decay or temperature H has no closed form in time; use fem"
            )
        parts = [
            (
                limit.value / theta[0],
                float(beginning.energies.sum()) / theta[0],
                float(modes.n),
                float(c[0]),
            )
        ]
    deepest = max(x for x, *_ in parts)
    if min(x for x, *_ in parts) > cir.DEEPEST or (deepest > cir.DEEPEST and len(parts) == 1):
        raise NotApplicable(
            f"the limit is {deepest:.0f} mean energies: the time to it leaves double precision"
        )
    parts = [part for part in parts if part[0] <= cir.DEEPEST]
    decays = [(cir.passage_decay(x, y, n), rate) for x, y, n, rate in parts]
    survivals = [d.survival(times * rate) for d, rate in decays]
    survival = np.asarray(prod(s for s, _ in survivals)) * np.ones(times.size)
    relative = modes.relative_error * (2.0 + 2.0 * deepest)
    lost = np.asarray(sum(e for _, e in survivals)) + relative * np.where(times > 0.0, 1.0, 0.0)
    if len(parts) == 1:
        x, y, n, rate = parts[0]
        m = cir.passage_moments(x, y, n)
        mean, variance = (
            Number(m.mean / rate, m.mean_error / rate),
            Number(m.variance / rate**2, m.variance_error / rate**2),
        )
    else:
        mean, variance = _first_of(decays)
    value = sum(float(d.rates[0]) * rate for d, rate in decays)
    error = sum(float(d.rate_errors[0]) * rate for d, rate in decays)
    mean, variance, least = (
        Number(x.value, x.error + factor * relative * x.value)
        for x, factor in ((mean, 1.0), (variance, 2.0), (Number(value, error), 1.0))
    )
    measured = Measured(
        l1_error=float(np.max([x.error / x.value for x in (mean, variance, least)] + list(lost))),
        mass_defect=0.0,
        minimum=float(np.min(survival, initial=1.0)),
        residual=0.0,
        tail_mass=0.0,
        absolute_error=float(np.max(lost, initial=0.0)),
    )
    return Passage(
        mean, variance, least, times, survival, lost, "numerical", certify(measured, tol=tol)
    )


def _first_of(decays: Sequence[tuple[cir.Decay, float]]) -> tuple[Number, Number]:
    """Mean and variance of the least of independent times: ∫S dt and ∫2t S dt, S the product.

    Before all modes of a reliability but those left out have decayed it lies between its value then
    and 1.
    """
    total = sum(d.rates[0] * rate for d, rate in decays)
    early = min(max(SETTLED / (d.rates[-1] * rate) for d, rate in decays), 1e-2 / total)
    nodes = np.linspace(np.log(early), np.log(1.5 * SETTLED / total), DECAY_PANELS + 1)
    answers = []
    for points in DECAY_POINTS:
        u, w = (a.ravel() for a in panel_rule(nodes, points))
        t = np.exp(u)
        parts = [d.survival(t * rate) for d, rate in decays]
        S, lost = prod(s for s, _ in parts), sum(e for _, e in parts)
        answers.append([[float(np.sum(w * t**k * k * f)) for f in (S, lost)] for k in (1, 2)])
    first = prod(float(d.survival(np.array([early * rate]))[0][0]) for d, rate in decays)
    results = []
    for k, (coarse, fine) in enumerate(zip(*answers, strict=True), start=1):
        value = fine[0] + 0.5 * (1.0 + first) * early**k
        results.append((value, abs(fine[0] - coarse[0]) + fine[1] + abs(1.0 - first) * early**k))
    (mean, mean_error), (square, square_error) = results
    return Number(mean, mean_error), Number(
        square - mean**2, square_error + 2.0 * mean * mean_error
    )


def modal_relaxation(modes: ModalAnalysis, solver: str, count: int, *, tol: float | None) -> Rates:
    """Return the ``count`` slowest rates but 0: sums of multiples of c*_ii in closed form."""
    if solver != "closed-form":
        if modes.n != 2:
            raise NotApplicable("relaxation rates by fem are those of two modal energies")
        frame = _frame(modes.process(_pair(modes, range(2))), tol or TOL)
        return relaxation_rates(frame, count, tol=tol or TOL, relative=modes.relative_error)
    _require_constant(modes)
    rates = np.zeros(1)
    for c in 2.0 * modes.half_bandwidth:
        rates = np.sort(np.add.outer(rates, c * np.arange(count + 1.0)).ravel())[: count + 1]
    values = rates[1:]
    errors = values * (modes.relative_error + 4.0 * cir.EPS)
    measured = Measured(float(np.max(errors / values)), 0.0, 0.0, 0.0, 0.0)
    return Rates(values.astype(complex), errors, certify(measured, tol=tol or TOL))
