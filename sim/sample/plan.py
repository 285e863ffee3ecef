"""The setup of a simulation, the arrays that the kernel reads, and the key of the kernel.

In a long step ``H = small · h``, trajectories that are *near* a stop in their state x at its start
make ``small`` steps ``h`` with kicks; *far* trajectories are mapped over the long step, which is
exact in law unless they touch a stop. With q the displacement of the mass and d the side of the
stop, a trajectory is far if

    max(d q(0), d q(H) + a) + b(x) < clearance ,

q(H) its mean motion without noise, a the ``noise_reach``, and b(x) from ``bends``. It then touches
the stop with a probability below 1.4e-11: docs/theory.md, "The step of the simulation".
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import ceil, inf, isfinite, log, sqrt
from typing import Literal

import numpy as np
from scipy.linalg import expm
from scipy.special import comb, ndtr

from fpk.answer.names import Coordinate, Observable
from fpk.numeric.arrays import Array, Integers
from fpk.numeric.errors import InvalidInput, require
from fpk.system.linear import drift_matrix, natural_modes
from fpk.system.system import System, effects_of
from sim.sample.diagnostics import Product
from sim.sample.histogram import Histogram, starts
from sim.sample.settings import NOT_IN_STATE, Settings, default_step
from sim.sample.workers import Checkpoint, checkpoint_of
from sim.step.arrays import LANES, NARROW, StepArrays, TermArrays, WatchArrays
from sim.step.kernel import KernelKey
from sim.step.schemes import SCHEMES, Scheme, exact_flow, lower_trapezoidal, pad_columns
from sim.step.step_size import relaxation_time, sampling_interval, stability_limit, temperature

LARGEST_NORMAL = sqrt(2.0 * 32.0 * log(2.0)) * (1.0 + 3e-6)
"""Largest radius √(z₁² + z₂²) of a pair of normals from a uniform number >= 2**-32, rounded up."""
SMALL_STEPS = (4, 8, 12, 16, 24, 32, 48, 64, 96, 128)
"""Numbers of small steps in a long step to choose from; few, so that round-off does not decide."""
LONG_COST, SMALL_COST, WORTH = 2.3, 1.2, 0.8
"""Processor time of a long step, and of a small step of a block in groups, in units of a step of a
block (by ``benchmarks/montecarlo.py``); long steps are made if ``relative_cost`` <= WORTH."""


def noise_reach(system: System, H: float, masses: Integers) -> Array:
    """Return the largest displacements of ``masses`` (masses,) by the noise of one step ``H``."""
    rows = lower_trapezoidal(exact_flow(system, H).factor)[masses]
    rows = np.pad(rows, ((0, 0), (0, rows.shape[1] % 2)))
    return np.asarray(LARGEST_NORMAL * np.hypot(rows[:, ::2], rows[:, 1::2]).sum(axis=1))


def bends(system: System, H: float, masses: Integers) -> Array:
    """Return rows (masses, 2n) whose product with |x|, x = (q, p) at the start of a step, is b(x).

    b(x) bounds how far, within a step ``H`` without contacts, the mean motion q(t) of ``masses``
    (numbers from 0) leaves the straight line between its ends. The curvature is bounded by its
    largest value on a grid of times, plus half an interval times the largest slope.
    """
    drift, step = drift_matrix(system), H / 64
    across, values = expm(drift * step), [drift[system.n + masses] / system.mass[masses, None]]
    for _ in range(64):
        values.append(values[-1] @ across)
    curvature, slope = np.abs(values).max(axis=0), np.abs(values @ drift).max(axis=0)
    return np.asarray(H**2 / 8.0 * (curvature + 0.5 * step * slope))


def relative_cost(system: System, dt: float, small: int) -> float:
    """Return the estimated processor time with long steps over the time with steps ``dt`` only.

    A long step is ``small`` · ``dt`` long (1: the result is 1). The share of trajectories that make
    small steps is computed for displacements with the Gibbs density at kT.
    """
    if small == 1:
        return 1.0
    H, kT, far, masses = small * dt, temperature(system), 1.0, system.contact_masses
    for i, reach in zip(masses, noise_reach(system, H, np.array(masses)), strict=True):
        k_eff = 1.0 / system.compliance[i, i]
        q = np.linspace(-6.0, 6.0, 4001) * sqrt(kT / k_eff)
        energy = 0.5 * k_eff * q * q + system.contact_energy(i, q)
        weight = np.exp(-(energy - energy.min()) / kT)
        near, width = np.zeros(q.size), H * sqrt(kT / system.mass[i])
        for stop in (s for s in system.stops if s.index == i):
            gap = stop.clearance - stop.sign * q
            near += np.where(gap <= 0.0, 1.0, ndtr((reach - gap) / width))
        far *= 1.0 - float(np.sum(np.minimum(near, 1.0) * weight) / np.sum(weight))
    count, share = np.arange(LANES + 1), 1.0 - far
    groups = np.ceil(count / NARROW) * NARROW / LANES
    chance = comb(LANES, count) * share**count * (1.0 - share) ** (LANES - count)  # binomial
    return LONG_COST / small + SMALL_COST * float(np.sum(chance * groups))


def with_long_steps(system: System, scheme: Scheme, dt: float) -> tuple[Scheme, float, str]:
    """Return ``scheme`` with the cheapest ``small``, its long step ``small`` · ``dt``, and words.

    Scheme and ``dt`` are returned unchanged if long steps are impossible or cost too much; the
    words say why. A long step is at most the sampling interval; only the exact flow can make it.
    """
    if not system.stops:
        return scheme, dt, "no contact: all trajectories make the same steps"
    if system.damping_terms:
        return scheme, dt, "damping terms act everywhere: all trajectories make the same steps"
    if scheme.linear_map is not exact_flow:
        return scheme, dt, f"{scheme.name} needs the small step everywhere"
    kT, longest = temperature(system), sampling_interval(system) * (1.0 + 1e-9) / dt
    choices = [m for m in SMALL_STEPS if m <= longest]
    if not choices or not (isfinite(kT) and kT > 0.0):
        return scheme, dt, "the contact does not limit the step"
    costs = [relative_cost(system, dt, m) for m in choices]
    small = choices[int(np.argmin(costs))]
    if min(costs) > WORTH:
        return scheme, dt, "too many trajectories are near a stop"
    words = f"{small} small steps near a stop, one elsewhere"
    return replace(scheme, small=small), small * dt, words


@dataclass(frozen=True, eq=False)
class Setup:
    """Everything that the numbers of a simulation of Eq. (6) depend on; times in the system's unit.

    ``dt`` is the long step if ``scheme`` has small steps. Each trajectory is sampled for ``time``
    or, if ``seconds`` is finite, for this wall time or until the expected L1 error of the first
    observable is below ``tol``. ``histograms`` None: bins over the range of a pilot. ``division``
    and ``limited_by`` are words of the report, ``failures`` reasons not to certify an answer.
    """

    method: Settings
    system: System
    observables: Sequence[Observable]
    scheme: Scheme
    dt: float
    time: float
    tol: float = inf
    seconds: float = inf
    histograms: tuple[Histogram, ...] | None = None
    division: str = ""
    limited_by: Literal["", "most_steps"] = ""
    failures: tuple[str, ...] = ()

    @cached_property
    def stride(self) -> int:
        """Steps from one sample to the next, 1 or more."""
        return max(1, round(sampling_interval(self.system) / self.dt))

    @cached_property
    def burn_in_steps(self) -> int:
        """Steps before the sampling begins."""
        return ceil(self.method.burn_in * relaxation_time(self.system) / self.dt)

    def checkpoint(self) -> Checkpoint:
        """Return the checkpoint in the method's folder, the same for all finite ``seconds``."""
        limited = self.seconds < inf
        return checkpoint_of(self.method.checkpoint, (self, limited), less=NOT_IN_STATE)


def setup_of(method: Settings, system: System, observables: Sequence[Observable]) -> Setup:
    """Return the setup of ``method`` for ``system`` and ``observables``, with steps and times.

    Raises ``InvalidInput`` for an unstable step without ``allow_unstable``, and for a step so short
    that random numbers run out.
    """
    scheme, failures = SCHEMES[method.scheme], list[str]()
    dt = method.dt or method.step_factor * default_step(method, system, observables)
    limit = stability_limit(system, scheme)
    if not 0.0 < dt < limit:
        remedy = f"must be > 0 and below the stability limit {limit:.4g} of {scheme.name}"
        require(method.allow_unstable, "dt", dt, remedy)
        failures.append(f"the step {dt:g} was insisted on: it {remedy}")
    # A trajectory uses n of its 2**40 random words in a step, 5/4 n with long steps.
    relaxation = relaxation_time(system)
    longest = method.burn_in * relaxation + (method.time or 0.0)
    if dt < (shortest := 2.0**-39 * system.n * longest):
        remedy = f"takes more random numbers than a trajectory has; use at least {shortest:.2g}"
        raise InvalidInput("dt", dt, remedy)
    scheme, long, division = with_long_steps(system, scheme, dt)
    tol = method.tol if method.tol is not None and observables else inf
    parts = 3.0 if method.step_pair else 1.0  # the run at half the step takes twice as long
    seconds = method.seconds / parts if method.seconds else method.longest if tol < inf else inf
    time = method.sampled_time(system, dt / relative_cost(system, dt, scheme.small))
    limited = method.time is None and time < method.relaxations * relaxation
    return Setup(
        method, system, tuple(observables), scheme, dt=long, time=time, tol=tol, seconds=seconds,
        division=division, limited_by="most_steps" if limited else "", failures=tuple(failures),
    )  # fmt: skip


def step_arrays(system: System, scheme: Scheme, dt: float, *, halved: bool = False) -> StepArrays:
    """Return the numbers of a step ``dt``, a long step if ``scheme.small`` > 1.

    ``halved``: the step has two linear maps, each over dt/2 with its own normals.
    """
    n, small, H = system.n, scheme.small, dt
    dt = H / small
    linear = scheme.linear_map(system, 0.5 * dt if halved else dt)
    springs = dt * system.stiffness_matrix if scheme.springs_kicked else np.zeros((0, 0))
    terms = None
    if system.damping_terms:  # in powers of the momenta p = m v
        factors, scales, numbers = [], [], []
        for term in system.damping_terms:
            v = list(term.powers("v", n))
            v[term.column] += 1
            scales.append(term.coefficient / float(np.prod(system.mass ** np.array(v))))
            numbers.append((n + term.row, v[term.row], term.energy))
            others = [*term.powers("q", n), *v[: term.row], 0, *v[term.row + 1 :]]
            factors.append(np.repeat([*range(2 * n), n + term.row], [*others, v[term.row]]))
        target, power, energy = np.array(numbers, dtype=np.int64).T.copy()
        first = np.cumsum([0, *map(len, factors)], dtype=np.int64)
        own = np.concatenate(factors)
        terms = TermArrays(target, power, np.array(scales), energy, first, own, springs)
    if springs.size and terms is None:
        one, zero = np.eye(n), np.zeros((n, n))
        kicked = linear.propagator @ np.block([[one, zero], [-springs, one]])
        linear = replace(linear, propagator=kicked)
    pairs = (linear.factor.shape[1] + 1) // 2
    laws, slots = effects_of(system).laws, system.contact_masses
    signs: dict[tuple[float, ...], list[float]] = {}  # equal stops on both sides are one
    for s in system.stops:
        key = slots.index(s.index), s.clearance, s.stiffness, s.power, laws.index(s.law)
        signs.setdefault(key, []).append(s.sign)
    rows = [
        (slot, sign, *shape)
        for (slot, *shape), sides in sorted(signs.items())
        for sign in ([0.0] if sorted(sides) == [-1.0, 1.0] else sides)
    ]
    stops, masses = np.array(rows, dtype=float).reshape(-1, 6), np.array(slots, dtype=np.int64)
    slot = stops[:, 0].astype(np.int64)
    long, mass, bend, reach = linear, masses[:0], np.zeros((0, 2 * n)), np.zeros(0)
    if small > 1:
        long, mass = exact_flow(system, H), masses[slot]
        bend, reach = bends(system, H, mass), noise_reach(system, H, mass)
    return StepArrays(
        matrix=linear.matrix,
        pairs=pairs,
        maps=1 + halved,
        dt=float(dt),
        stiffness_matrix=system.stiffness_matrix,
        half_inverse_mass=0.5 / system.mass,
        slot_mass=masses,
        slot_shift=scheme.modified * dt**2 / system.mass[masses],
        stop_slot=slot,
        stops=np.ascontiguousarray(stops[:, 1:]),
        terms=terms,
        words=pairs * (small + 1) if small > 1 else pairs * (1 + halved),
        small=small,
        long_matrix=long.matrix,
        after=pad_columns(long.propagator[mass]),
        bend=pad_columns(bend),
        reach=reach,
        strength=np.zeros(0, np.float32),
    )


def observation_arrays(
    system: System,
    scheme: Scheme,
    step: StepArrays,
    histograms: Sequence[Histogram],
    products: Sequence[Product],
    traced: Sequence[Coordinate] = (),
) -> tuple[KernelKey, WatchArrays]:
    """Return the key of the kernel for a motion by ``step``, and the numbers that it observes by.

    Observed states are counted in ``histograms``; ``products`` are summed; ``traced`` coordinates
    are copied to the trace in this order.
    """
    n, slots, effects = system.n, step.slot_mass, effects_of(system)
    observed = {c for histogram in histograms for c in histogram.observable} | {*traced}
    modes = sorted(c.row for c in observed if c.kind == "H" and c.index is not None)
    forces = 0 if step.terms is None else n
    sizes = [2 * slots.size, n, n, n, 1, len(modes), forces, 3 * forces, 5 if forces else 1]
    begins: list[int] = np.cumsum([step.matrix.shape[1] + 2 * n, *sizes]).tolist()
    at = dict(zip(WatchArrays._fields[-len(begins) :], begins, strict=True))
    first = {"q": at["q"], "p": at["p"], "f": at["force"], "d": at["damping"]}

    def row_of(c: Coordinate) -> int:
        if c.kind != "H":
            return first[c.kind] + c.row
        return at["energy"] if c.index is None else at["modal"] + modes.index(c.index)

    shapes, frequency = natural_modes(system)
    T = shapes.T[modes]
    rows = np.full((len(histograms), 2), -1, dtype=np.int64)  # −1: no second axis
    bins, piece = np.ones_like(rows), np.zeros((len(histograms), 2, 2), dtype=np.int64)
    pieces: list[tuple[float, ...]] = []
    for m, histogram in enumerate(histograms):
        for k, (c, axis) in enumerate(zip(histogram.observable, histogram.bins, strict=True)):
            rows[m, k], bins[m, k], begin = row_of(c), axis.edges.size - 1, len(pieces)
            for first_edge, last_edge in pairwise(axis.cuts):
                low, high = axis.edges[[first_edge, last_edge]].tolist()
                widens, count = low in axis.widening, last_edge - first_edge
                unit = 1.0 if widens else float(count)
                pieces.append((low, high, count, unit / (high - low), widens))
            piece[m, k] = begin, len(pieces)
    half, shift = 0.5 * step.dt if scheme.kick_first else 0.0, scheme.modified * step.dt**2
    summed = [(first[a] + i, first[b] + j) for a, i, b, j in products]
    watch = WatchArrays(
        half_kick=half,
        half_springs=(half if scheme.springs_kicked else 0.0) * system.stiffness_matrix,
        term_shift=shift,
        cross=shift * system.damping[:, slots] / system.mass[slots],
        mode_q=frequency[modes, None] * T * system.mass,
        mode_p=np.ascontiguousarray(T),
        start=starts(histograms)[:-1],
        products=np.array(summed, dtype=np.int64).reshape(-1, 2),
        traced=np.array([row_of(c) for c in traced], dtype=np.int64),
        rows=rows,
        bins=bins,
        pieces=np.array(pieces, dtype=float).reshape(-1, 5),
        piece=piece,
        **at,
    )
    key = KernelKey(
        laws=effects.laws,
        kick_first=scheme.kick_first or not (effects.stops or effects.state_damping),
        damping=effects.state_damping,
        energy_damping=effects.energy_damping,
        energy=Coordinate("H") in observed or bool(products and effects.energy_damping),
        moments=bool(products),
        pairs=step.pairs,
        substeps=step.small > 1,
    )
    return key, watch
