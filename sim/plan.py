"""From a system, a scheme and a step to the arrays that the kernel reads, and its key."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fpk.arrays import Array
from fpk.linear import natural_modes
from fpk.observable import Coordinate
from fpk.system import System, effects_of
from sim.arrays import Rows, StepArrays, TermArrays, WatchArrays
from sim.histogram import Histogram, starts
from sim.kernel import KernelKey
from sim.schemes import Scheme
from sim.statistics import Product
from sim.substeps import substep_arrays


def step_arrays(system: System, scheme: Scheme, dt: float, *, halved: bool = False) -> StepArrays:
    """Return the numbers of one step of ``dt``; a stop equal on both sides counts as one.

    Of a long step they belong to its small ones; ``substeps`` has the long one. ``halved``: the
    linear map is that of dt/2, of which a step makes two, with the normals of two steps dt/2.
    """
    n, small, H = system.n, scheme.small, dt
    dt = H / small
    linear = scheme.linear_map(system, 0.5 * dt if halved else dt)
    springs = dt * system.stiffness_matrix if scheme.springs_kicked else np.zeros((0, 0))
    terms = term_arrays(system, springs) if system.damping_terms else None
    if springs.size and terms is None:
        one, zero = np.eye(n), np.zeros((n, n))
        kicked = linear.propagator @ np.block([[one, zero], [-springs, one]])
        linear = replace(linear, propagator=kicked)
    pairs = (linear.factor.shape[1] + 1) // 2
    laws, slots = effects_of(system).laws, system.contact_masses
    signs: dict[tuple[float, ...], list[float]] = {}
    for stop in system.stops:
        shape = (stop.clearance, stop.stiffness, stop.power, laws.index(stop.law))
        signs.setdefault((slots.index(stop.index), *shape), []).append(stop.sign)
    rows = [
        (slot, sign, *shape)
        for (slot, *shape), sides in sorted(signs.items())
        for sign in ([0.0] if sorted(sides) == [-1.0, 1.0] else sides)
    ]
    stops, masses = np.array(rows, dtype=float).reshape(-1, 6), np.array(slots, dtype=np.int64)
    slot = stops[:, 0].astype(np.int64)
    return StepArrays(
        matrix=linear.matrix,
        pairs=pairs,
        dt=float(dt),
        stiffness_matrix=system.stiffness_matrix,
        half_inverse_mass=0.5 / system.mass,
        slot_mass=masses,
        slot_shift=scheme.modified * dt**2 / system.mass[masses],
        stop_slot=slot,
        stops=np.ascontiguousarray(stops[:, 1:]),
        terms=terms,
        words=pairs * (small + 1) if small > 1 else pairs * (1 + halved),
        substeps=substep_arrays(system, H, small, masses[slot]) if small > 1 else None,
    )


def term_arrays(system: System, springs: Array) -> TermArrays:
    """Return the damping terms as powers of the momenta ``p = m v``; see ``TermArrays``."""
    n, factors, powers, scales = system.n, [], [], []
    for term in system.damping_terms:
        v = list(term.powers("v", n))
        v[term.column] += 1
        powers.append(v[term.row])
        scales.append(term.coefficient / float(np.prod(system.mass ** np.array(v))))
        v[term.row] = 0
        others = [*term.powers("q", n), *v]
        factors.append(np.repeat([*range(2 * n), n + term.row], [*others, powers[-1]]))
    return TermArrays(
        target=np.array([n + term.row for term in system.damping_terms], dtype=np.int64),
        power=np.array(powers, dtype=np.int64),
        scale=np.array(scales),
        energy=np.array([term.energy for term in system.damping_terms], dtype=np.int64),
        first=np.cumsum([0, *map(len, factors)], dtype=np.int64),
        factor=np.concatenate(factors),
        springs=springs,
    )


def watched(
    system: System,
    scheme: Scheme,
    step: StepArrays,
    histograms: Sequence[Histogram],
    products: Sequence[Product],
    traced: Sequence[Coordinate] = (),
    *,
    halved: bool = False,
) -> tuple[KernelKey, WatchArrays]:
    """Return what the kernel must be compiled for, and the numbers that it reads to observe."""
    n, slots, effects = system.n, step.slot_mass, effects_of(system)
    observed = {c for histogram in histograms for c in histogram.observable} | {*traced}
    kinds = {c.kind for c in observed}
    modes = sorted(c.row for c in observed if c.kind == "H" and c.index is not None)
    forces = 0 if step.terms is None else n
    work = 5 if forces else int(bool(modes))
    sizes = [2 * slots.size, n, n, n, 1, len(modes), forces, 3 * forces, work]
    at = Rows(*np.cumsum([step.matrix.shape[1] + 2 * n, *sizes]).tolist())
    first = {"q": at.q, "p": at.p, "f": at.force, "d": at.damping}

    def row_of(c: Coordinate) -> int:
        if c.kind != "H":
            return first[c.kind] + c.row
        return at.energy if c.index is None else at.modal + modes.index(c.index)

    shapes, frequency = natural_modes(system) if modes else (np.zeros((n, 0)), np.zeros(0))
    T = shapes.T[modes]
    binned = _binned(histograms, row_of)
    half, shift = 0.5 * step.dt if scheme.kick_first else 0.0, scheme.modified * step.dt**2
    watch = WatchArrays(
        half_kick=half,
        half_springs=(half if scheme.springs_kicked else 0.0) * system.stiffness_matrix,
        term_shift=shift,
        cross=shift * system.damping[:, slots] / system.mass[slots],
        mode_q=frequency[modes, None] * T * system.mass if modes else None,
        mode_p=np.ascontiguousarray(T) if modes else None,
        at=at,
        start=starts(histograms)[:-1],
        products=np.array(
            [(first[a] + i, first[b] + j) for a, i, b, j in products], dtype=np.int64
        ).reshape(-1, 2),
        traced=np.array([row_of(c) for c in traced], dtype=np.int64),
        **binned,
    )
    key = KernelKey(
        laws=effects.laws,
        kick_first=scheme.kick_first or not (effects.contact or effects.state_damping),
        damping=effects.state_damping,
        energy_damping=effects.energy_damping,
        observed=bool(kinds or products),
        momenta=bool(kinds & {"p", "H"} or products or effects.state_damping),
        energy=Coordinate("H") in observed or bool(products and effects.energy_damping),
        modes=bool(modes),
        moments=bool(products),
        pairs=step.pairs,
        substeps=step.substeps is not None,
        traced=bool(traced),
        halved=halved,
    )
    return key, watch


def _binned(histograms: Sequence[Histogram], row_of: Callable[[Coordinate], int]) -> dict[str, Any]:
    """Return the fields of ``WatchArrays`` by which bins are found; no axis: row −1."""
    rows = np.full((len(histograms), 2), -1, dtype=np.int64)
    bins, piece = np.ones_like(rows), np.zeros((len(histograms), 2, 2), dtype=np.int64)
    pieces: list[tuple[float, ...]] = []
    for m, histogram in enumerate(histograms):
        for k, (c, axis) in enumerate(zip(histogram.observable, histogram.bins, strict=True)):
            rows[m, k], bins[m, k], begin = row_of(c), axis.edges.size - 1, len(pieces)
            for low, high, count, widens in axis.pieces:
                unit = 1.0 if widens else float(count)
                pieces.append((low, high, count, unit / (high - low), widens))
            piece[m, k] = begin, len(pieces)
    table = np.array(pieces, dtype=float).reshape(-1, 5)
    return {"rows": rows, "bins": bins, "pieces": table, "piece": piece}
