"""Relaxation rates of one energy: eigenvalues of −L without flux at the ends, by counting them."""

import math

import numpy as np

from fpk.arrays import EPS, Array, Integers
from fpk.certificate import Measured, certify
from fpk.dynamics import Rates
from fpk.errors import NotCertified
from fpk.line.mesh import split_points
from fpk.line.time.elements import Elements, degree_for, meshed
from fpk.line.time.mesh import time_nodes
from fpk.line.time.resolvent import admittances, eliminated
from fpk.probe import probed
from fpk.process import Process

SAFETY = 2.0
"""Factor on the distance to the enriched solution."""
TAIL = (1e-4, 1e-9)
"""Share of the tolerance that π φ² has beyond the mesh: of the answer, and of the enriched one."""
GRID = 400
"""Energies in a decade at which the last one is chosen."""
ROUND_OFF = 8.0
"""Roundings of the pivots along the chain, for each element."""
LONGER = 1.3
"""Factor on the last energy from one round to the next."""
WAVES = 10
"""Waves of an eigenfunction that an element takes: towards H = 0 the k-th has k a temperature."""
POINTS = 160
"""Trial values at which eigenvalues are counted at once: fewer take no less time, and halving the
interval of each eigenvalue takes the fewest in all."""
MOST_ROUNDS, MOST_ELEMENTS = 6, 1_000
"""Rounds, at every second of which all elements are cut in two, and elements that end them."""


def eigenvalues_below(e: Elements, rates: Array) -> Integers:
    """Return how many eigenvalues, 0 among them, are less than each of ``rates`` (points,).

    As many as pivots of A − λM are negative (Sylvester), those of the own functions of the elements
    among them (Wittrick and Williams, Q. J. Mech. Appl. Math. 24 (1971) 263).
    """
    y = admittances(e, -rates)
    s = eliminated(e, y)
    inner, ends = (y.damped < 0.0).sum(axis=(0, 1)), (s.total[1:] < 0.0).sum(axis=0)
    return np.asarray(inner + ends + (s.passed[-1] + y.shunt[-1, 1] < 0.0))


def eigenvalues(e: Elements, count: int, scale: float) -> Array:
    """Return the ``count`` least eigenvalues > 0 of −L, by section; ``scale`` is of their order."""
    trial = scale * 2.0 ** np.arange(-80.0, 81.0)
    below = eigenvalues_below(e, trial)
    wanted, sections = np.arange(2, count + 2), 1 + max(1, POINTS // count)
    low, high = (trial[np.searchsorted(below, wanted) + k] for k in (-1, 0))
    while np.any(high - low > 2.0 * EPS * high):
        share = np.arange(1.0, sections) / sections
        grid = low[:, None] * (high / low)[:, None] ** share
        below = eigenvalues_below(e, grid.ravel()).reshape(grid.shape)
        k = (below < wanted[:, None]).sum(axis=1)
        every = np.column_stack([low, grid, high])
        before = high - low
        low, high = np.take_along_axis(every, np.stack([k, k + 1], 1), 1).T
        if not np.any(high - low < before):
            break
    return 0.5 * (low + high)


def spectrum(process: Process, count: int, *, tol: float = 1e-10) -> Rates:
    """Return the ``count`` least eigenvalues of −L but 0, all of them real.

    To the relative tolerance ``tol``; the mesh adapts.
    """
    degree, scale = degree_for(tol), process.energy_scale
    special = np.array([0.0, *process.nonsmooth])
    order = float(process.coefficients(np.array([scale])).diffusion[0]) / scale**2
    wave = WAVES / count * scale / process.degrees_of_freedom
    for turn in range(MOST_ROUNDS):
        end, last = (LONGER**turn * _extent(process, count, share * tol) for share in TAIL)
        nodes = time_nodes(process, end, degree, fine=((0.0, wave),) if count > WAVES else ())
        for _ in range(turn // 2):
            nodes = np.sort(np.append(nodes, split_points(nodes[:-1], nodes[1:], special)))
        pair = meshed(process, nodes, degree, beyond=np.array([last]))
        answer, (rates, better) = pair[0], (eigenvalues(e, count, order) for e in pair)
        common = 2.0 * answer.coefficient_error()
        common += ROUND_OFF * EPS * (answer.count + float(np.ptp(answer.log_scale)))
        errors = SAFETY * np.abs(rates - better) + common * rates
        if (errors <= tol * rates).all() or 2 * answer.count > MOST_ELEMENTS:
            break
    relative = float((errors / rates).max())
    # The eigenvalue 0 of the constant is there whatever the elements: no probability is lost.
    residual = float(eigenvalues_below(answer, rates[:1] * 0.5)[0] != 1)
    measured = Measured(relative, None, None, residual, None)
    settings = {"elements": answer.count, "tol": tol}
    return Rates(rates.astype(complex), errors, certify(measured, tol=tol), settings)


def _extent(process: Process, count: int, tail: float) -> float:
    """Return an energy beyond which π φ² has the share ``tail``; φ ~ H^``count``."""
    probe = probed(process)
    ln_energy = np.arange(np.log(probe.energy[0]), np.log(probe.energy[-1]), np.log(10.0) / GRID)
    log_mass = np.interp(ln_energy, np.log(probe.energy), probe.log_mass)
    log_temperature = np.log(process.energy_scale / process.degrees_of_freedom)
    grown = log_mass + 2.0 * count * np.maximum(ln_energy - log_temperature, 0.0)
    wanted = log_mass.max() + math.log(tail)
    if not grown[-1] < wanted:
        raise NotCertified("the density does not fall faster than the eigenfunctions rise")
    return float(np.exp(ln_energy[np.flatnonzero(grown >= wanted)[-1] + 1]))
