"""Relaxation rates of one energy: eigenvalues of −L without flux at the ends, and their number."""

from dataclasses import replace

import numpy as np
from scipy.sparse.linalg import eigsh

from fpk.answer.dynamics import Rates, certified_rates
from fpk.numeric.arrays import EPS, ROUNDINGS, Array, Integers
from fpk.numeric.errors import NotCertified
from fpk.solvers.line.mesh import split_points, time_nodes
from fpk.solvers.line.time.elements import MOST_ELEMENTS, SAFETY, Elements, degree_for, meshed
from fpk.solvers.line.time.modulated import matrices
from fpk.solvers.line.time.resolvent import eliminated
from fpk.solvers.line.time.transition import TAIL
from fpk.solvers.probe import probed
from fpk.system.process import Process

LONGER = 1.3
"""Factor on the last energy from one round to the next."""
WAVES = 10
"""Waves of an eigenfunction that an element takes: towards H = 0 the k-th has k a temperature."""
ROUNDS = 6
"""Most rounds, at every second of which all elements are cut in two."""


SHIFT = 0.1
"""Shift below 0 of the inverse, in units of the scale of the rates: K alone is singular."""


def eigenvalues_below(e: Elements, rates: Array) -> Integers:
    """Return how many eigenvalues, 0 among them, are less than each of ``rates`` (points,).

    As many as pivots of A − λM are negative (Sylvester), those of the own functions of the elements
    among them (Wittrick and Williams, Q. J. Mech. Appl. Math. 24 (1971) 263).
    """
    _, shunt, damped, total, _, passed = eliminated(e, -rates)
    inner, ends = (damped < 0.0).sum(axis=(0, 1)), (total[1:] < 0.0).sum(axis=0)
    return np.asarray(inner + ends + (passed[-1] + shunt[-1, 1] < 0.0))


def eigenvalues(e: Elements, count: int, scale: float) -> Array:
    """Return the ``count`` least eigenvalues > 0 of −L; ``scale`` is of their order."""
    M, K, *_ = matrices(e)
    first = np.linspace(1.0, 2.0, M.shape[0])
    shift = -SHIFT * scale
    try:
        found = eigsh(K, count + 1, M, sigma=shift, v0=first, return_eigenvectors=False)
    except RuntimeError as error:  # of the factorisation, or of an iteration that does not end
        raise NotCertified(f"the relaxation rates were not found: {error}") from None
    return np.asarray(np.sort(found)[1:])


def spectrum(process: Process, count: int, *, tol: float = 1e-10) -> Rates:
    """Return the ``count`` least eigenvalues of −L but 0, all of them real.

    To the relative tolerance ``tol``; the mesh adapts. It ends where π φ², φ ~ H^``count``, has the
    share ``TAIL``.
    """
    degree, scale = degree_for(tol), process.energy_scale
    special = np.array([0.0, *process.nonsmooth])
    order = float(process.coefficients(np.array([scale])).diffusion[0]) / scale**2
    temperature = scale / process.degrees_of_freedom
    wave = WAVES / count * temperature
    # φ rises from the temperature on. Of a Laguerre polynomial of the norm 1, with φ ~ H^count, the
    # largest π φ² far out is 4^count.
    probe = probed(process)
    rise = np.where(probe.energy > temperature, 2.0 * count / probe.energy, 0.0)
    grown = replace(probe, slope=probe.slope + rise)
    try:
        ends = [grown.extent(tail * tol * 0.25**count) for tail in TAIL]
    except NotCertified:
        words = "the density does not fall faster than the eigenfunctions rise"
        raise NotCertified(words) from None
    for turn in range(ROUNDS):
        end, last = (LONGER**turn * energy for energy in ends)
        nodes = time_nodes(process, end, degree, fine=((0.0, wave),) if count > WAVES else ())
        for _ in range(turn // 2):
            nodes = np.sort(np.append(nodes, split_points(nodes[:-1], nodes[1:], special)))
        pair = meshed(process, nodes, degree, beyond=np.array([last]))
        answer, (rates, better) = pair[0], (eigenvalues(e, count, order) for e in pair)
        common = 2.0 * answer.coefficient_error()
        common += ROUNDINGS * EPS * (answer.count + answer.log_range)
        errors = SAFETY * np.abs(rates - better) + common * rates
        # Round-off of the inverse, relative to its largest eigenvalue, as one of λ.
        errors += ROUNDINGS * EPS * (rates + SHIFT * order) ** 2 / (SHIFT * order)
        if (errors <= tol * rates).all() or 2 * answer.count > MOST_ELEMENTS:
            break
    # The eigenvalue 0 of the constant is there whatever the elements: no probability is lost. And
    # no rate is missed.
    beyond = rates[-1] + max(float(errors[-1]), tol * float(rates[-1]))
    below = eigenvalues_below(answer, np.array([0.5 * rates[0], beyond]))
    residual = float(below.tolist() != [1, count + 1])
    settings = {"elements": answer.count, "tol": tol}
    return certified_rates(rates, errors, tol=tol, residual=residual, settings=settings)
