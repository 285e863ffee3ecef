"""The chain of elements of one energy for complex Laplace variables, and relaxation rates.

At the nodes an equation (zM + A) f = load describes a chain of conductances in series with
admittances to ground. In elimination from one end all terms of each sum have one sign (z > 0), or
lie in one sector of the complex plane: nothing cancels, however many decades the density spans.
"""

from dataclasses import replace
from itertools import accumulate
from math import acosh, ceil, log, pi, sin
from typing import Any

import numpy as np
from scipy.sparse import block_diag, coo_array, csc_array
from scipy.sparse.linalg import eigsh

from fpk.answer.certificate import DISTANCE_FACTOR
from fpk.answer.dynamics import Rates, certify_rates
from fpk.numeric.arrays import EPS, ROUNDINGS, SMALLEST, Array, Complexes, Integers
from fpk.numeric.errors import NotCertified
from fpk.solvers.line.mesh import probe_process, split_points, time_nodes
from fpk.solvers.line.time import elements as chain
from fpk.solvers.line.time.elements import ChainDensity, Elements
from fpk.system.process import Process

CONTOUR_TIMES = 10.0
"""Largest ratio of times that share one contour: it has 75 points, a contour of one time 46."""
PHI = 0.5
"""Angle φ of the hyperbola of ``contours``. Larger angles (1.17) converge faster but stay close to
the negative axis, where the transform of a density delayed by t_0 grows as e^(−z t_0): with many
masses started at rest the integral then cancels to less than a millionth of its terms."""
CONTOUR_VERTEX = 6.0
"""μ t of a hyperbola z = μ (1 + sin(iθ − PHI)) at its last time t: it crosses the real axis at
z t = 3.1, and round-off is multiplied by e^3.1."""
LONGER = 1.3
"""Factor on the last energy of the mesh from one round of ``relaxation_spectrum`` to the next."""
RATE_ROUNDS = 6
"""Largest number of rounds of ``relaxation_spectrum``; every other round halves all elements."""
SHIFT = 0.1
"""Shift of the inverse (K + shift M)⁻¹, over the scale b/H² of the rates: K alone is singular."""
Numbers = np.ndarray[tuple[Any, ...], np.dtype[Any]]
"""Arrays of real numbers, or of complex numbers if the Laplace variables are complex."""


def contours(times: Array, *, more: int = 0) -> list[tuple[Integers, Complexes, Complexes]]:
    """Return contours of the inverse Laplace transform for ``times`` > 0 in any order.

    A contour has the indices of its times, the points z, and the factors e^(z t) w (times, points)
    of f(t) = Im Σ e^(z t) w F(z): the trapezoidal rule of step h on the half Im z > 0 of the
    hyperbola z(θ) = μ (1 + sin(iθ − φ)). Its error is e^(μt − 2πφ/h), and it ends where e^(z t) is
    round-off at the first time; ``more`` points are added within, at a smaller step. J. A. C.
    Weideman and L. N. Trefethen, Math. Comp. 76 (2007) 1341.
    """
    order, found, digits = np.argsort(times, kind="stable"), [], -log(EPS)
    while order.size:
        first = times[order[0]]
        together = order[times[order] <= CONTOUR_TIMES * first]
        order = order[together.size :]
        last = float(times[together[-1]])
        mu, reach = CONTOUR_VERTEX / last, digits * last / float(first) + CONTOUR_VERTEX
        step = 2.0 * pi * PHI / (CONTOUR_VERTEX + digits)
        points = ceil(acosh(reach / (CONTOUR_VERTEX * sin(PHI))) / step)
        step *= points / (points + more)
        theta = step * (np.arange(points + more) + 0.5)
        z = mu * (1.0 + np.sin(1j * theta - PHI))
        weights = step / pi * mu * 1j * np.cos(1j * theta - PHI)
        factors = np.exp(np.multiply.outer(times[together], z)) * weights
        found.append((together, z, factors))
    return found


def eliminate_chain(e: Elements, z: Numbers) -> tuple[Numbers, ...]:
    """Return the admittances of the elements ``e`` at the Laplace variables ``z`` (points,).

    Arrays (elements, points), with all elements below eliminated: ``series`` is the conductance
    from end to end, ``shunt`` (elements, 2, points) the admittances to ground at both ends,
    ``damped`` (elements, functions − 2, points) is 1 + zν of the functions v_j, ν = ``relaxation``,
    ``total`` the sum of admittances at the left end, ``ratio`` is series/total, and ``passed`` the
    admittance below, seen through the element from its right end. In the first element ``total`` is
    1, and ``series``, ``ratio`` and ``passed`` are 0.
    """
    coupling, own = e.mass[:, 2:, :2], e.load[:, 2:]
    damped = 1.0 + e.relaxation[:, :, None] * z
    pairs = np.stack([coupling[:, :, 0] * coupling[:, :, 1], *np.moveaxis(coupling, 2, 0) * own])
    sums = np.einsum("aev,evz->aez", pairs, 1.0 / damped)
    series = e.conductance[:, None] - z * (e.mass[:, 0, 1, None] - z * sums[0])
    shunt = z * (e.load[:, :2, None] - z * np.moveaxis(sums[1:], 0, 1))
    total, ratio, passed = np.ones_like(series), np.zeros_like(series), np.zeros_like(series)
    for k in range(1, e.count):
        below = (passed[k - 1] + shunt[k - 1, 1]) * e.steps[k - 1] + shunt[k, 0]
        total[k] = below + series[k]
        zero = total[k] == 0.0  # at an eigenvalue of the part below
        total[k, zero] = EPS * series[k, zero]  # instead of a division by 0
        ratio[k] = series[k] / total[k]
        passed[k] = below * ratio[k]
    return series, shunt, damped, total, ratio, passed


def chain_resolvent(
    e: Elements, z: Numbers, load: Array, end: Numbers | None = None, *, density: bool = True
) -> tuple[Numbers, float]:
    """Return coefficients f (elements, functions, points) of (z − L) f = ``load``, and a residual.

    ``z`` (points,) are Laplace variables, ``load`` is (elements, functions). ``end`` (points,) is f
    at the right end of the last element; None: zero flux there. If ``density``, f = p/π in the unit
    1/e^``log_scale`` of each element, the load is in one unit, and the residual is relative, at the
    nodes. Otherwise f is in one unit, the load in the units of the elements, and the residual 0.
    """
    series, shunt, damped, total, ratio, passed = eliminate_chain(e, z)
    coupling = e.mass[:, 2:, :2]
    up, down = (np.ones(e.count - 1), e.steps) if density else (e.steps, np.ones(e.count - 1))
    inner = load[:, 2:, None] / damped
    source = load[:, :2, None] - z * np.einsum("eva,evz->eaz", coupling, inner)
    current = np.zeros_like(total)
    for k in range(1, e.count):
        current[k] = (ratio[k - 1] * current[k - 1] + source[k - 1, 1]) * up[k - 1] + source[k, 0]
    f = np.empty((e.count, e.degree + 1, z.size), dtype=total.dtype)
    low, high = f[:, 0], f[:, 1]
    if end is None:
        end = (ratio[-1] * current[-1] + source[-1, 1]) / (passed[-1] + shunt[-1, 1])
    high[-1] = end
    for k in range(e.count - 1, 0, -1):
        low[k] = ratio[k] * high[k] + current[k] / total[k]
        high[k - 1] = low[k] * down[k - 1]
    low[0] = high[0]
    f[:, 2:] = inner - z * np.einsum("eva,eaz->evz", coupling, f[:, :2]) / damped
    if not density:
        return f, 0.0
    flux = series * high, series * low
    right = np.array([flux[0], -flux[1], shunt[:, 1] * high, -source[:, 1]])[:, :-1]
    left = np.array([flux[1], -flux[0], shunt[:, 0] * low, -source[:, 0]])[:, 1:]
    terms = np.concatenate([right, left])
    # Smaller numbers lose precision in their products with EPS.
    size = np.maximum(np.abs(terms).sum(axis=0), SMALLEST / EPS)
    return f, float((np.abs(terms.sum(axis=0)) / size).max())


def inverse_laplace(
    e: Elements, load: Array, times: Array, *, held: float | None = None, more: int = 0,
    density: bool = True,
) -> ChainDensity:  # fmt: skip
    """Return the solution on ``e`` at ``times`` > 0 of ∂f/∂t = L f that starts with ``load``.

    For ``load`` and ``density`` see ``chain_resolvent``, for ``more`` see ``contours``. At the last
    end f = ``held`` at all times, or the flux is zero if None.
    """
    values, size = np.zeros((2, times.size, e.count, e.degree + 1))
    residuals = [0.0]
    for places, z, factors in contours(times, more=more):
        end = None if held is None else held / z
        f, residual = chain_resolvent(e, z, load, end, density=density)
        values[places] = np.einsum("tz,eiz->tei", factors, f).imag
        size[places] = np.einsum("tz,eiz->tei", np.abs(factors), np.abs(f))
        residuals.append(residual)
    return ChainDensity(e, values, size, float(np.max(residuals)))


def chain_potential(e: Elements, load: Array) -> Array:
    """Return f (elements, functions) of −L f = ``load``, f = 0 at the right end: first passage.
    ``load`` (elements, functions) is in the units of π in the elements, f in one unit."""
    own = zip(load[:, :2].sum(axis=1), e.steps, strict=False)
    below = accumulate(own, lambda current, k: (current + k[0]) * k[1], initial=0.0)
    current = np.fromiter(below, float, e.count) + load[:, 0]
    drop = np.append(current[:0:-1] / e.conductance[:0:-1], 0.0)
    ends = np.append(0.0, np.cumsum(drop))[::-1]
    return np.concatenate([ends[:-1, None], ends[1:, None], load[:, 2:]], axis=1)


def matrices(e: Elements, *, absorbing: bool = False) -> tuple[csc_array, ...]:
    """Return the sparse mass, stiffness and drift matrices M, K, C, and the map to elements.

    The unknowns are the free functions, scaled so that M has a unit diagonal. At the last end the
    flux is zero, or the function if ``absorbing``. The map (functions of all elements, unknowns)
    contains e^(½ ``log_scale``) times the scale of each unknown.
    """
    size = e.degree + 1
    K_local = np.tile(np.eye(size), (e.count, 1, 1))
    K_local[:, :2, :2] = e.conductance[:, None, None] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    # A node belongs to h_1 of the element on its left and to h_0 of the element on its right.
    place = np.arange(e.count * size).reshape(e.count, size)
    place[1:, 0] = place[:-1, 1]
    masses = np.einsum("eii->ei", e.mass)
    used = masses != 0.0
    used[-1, 1] &= not absorbing
    numbers, free = np.unique(place[used], return_inverse=True)
    unit = np.broadcast_to(e.log_scale[:, None], place.shape)[used]
    log_mass = np.full(numbers.size, -np.inf)
    np.logaddexp.at(log_mass, free, np.log(masses[used]) + unit)
    factor, shape = np.exp(0.5 * (unit - log_mass[free])), (used.size, numbers.size)
    spread = csc_array(coo_array((factor, (np.flatnonzero(used), free)), shape))
    blocks = (block_diag(A, format="csc") for A in (e.mass, K_local, e.drift))
    return *(csc_array(spread.T @ A @ spread) for A in blocks), spread


def eigenvalues_below(e: Elements, rates: Array) -> Integers:
    """Return how many eigenvalues of −L on ``e``, 0 included, are below each of the ``rates``.

    It is the number of negative pivots of A − λM: W. H. Wittrick and F. W. Williams, Q. J. Mech.
    Appl. Math. 24 (1971) 263.
    """
    _, shunt, damped, total, _, passed = eliminate_chain(e, -rates)
    inner, ends = (damped < 0.0).sum(axis=(0, 1)), (total[1:] < 0.0).sum(axis=0)
    return np.asarray(inner + ends + (passed[-1] + shunt[-1, 1] < 0.0))


def relaxation_spectrum(process: Process, count: int, *, tol: float = 1e-10) -> Rates:
    """Return the ``count`` smallest nonzero eigenvalues of −L of ``process``, to relative ``tol``.

    The mesh ends where π φ² of an eigenfunction φ ~ H^``count`` has the mass ``TAIL_SHARES`` · tol
    beyond. If the number of smaller eigenvalues shows that a rate was missed, the certificate fails
    by a residual of 1. Raises ``NotCertified`` if π φ² does not fall, or no eigenvalues are found.
    """
    degree, scale = chain.degree_for(tol), process.energy_scale
    order = float(process.coefficients(np.array([scale])).diffusion[0]) / scale**2
    temperature = scale / process.degrees_of_freedom
    # φ rises above the temperature. π φ² of a Laguerre polynomial of norm 1, φ ~ H^count, is at
    # most 4^count times the continuation of its tail.
    probe = probe_process(process)
    rise = np.where(probe.energy > temperature, 2.0 * count / probe.energy, 0.0)
    grown = replace(probe, slope=probe.slope + rise)
    try:
        ends = np.array([grown.extent(tail * tol * 0.25**count) for tail in chain.TAIL_SHARES])
    except NotCertified:
        words = "the density does not fall faster than the eigenfunctions rise"
        raise NotCertified(words) from None
    # Near H = 0 the k-th eigenfunction has k waves over the energy ``temperature``; an element of
    # degree p resolves p/2.
    waves = degree // 2
    fine = [(0.0, waves / count * temperature)] if count > waves else []
    for turn in range(RATE_ROUNDS):
        end, last = LONGER**turn * ends
        nodes = time_nodes(process, end, degree, fine=fine)
        for _ in range(turn // 2):
            at = split_points(nodes[:-1], nodes[1:], process.nonsmooth)
            nodes = np.sort(np.append(nodes, at))
        pair, found = chain.element_pair(process, nodes, degree, beyond=[last]), []
        for e in pair:
            M, K, *_ = matrices(e)
            first, shift = np.linspace(1.0, 2.0, M.shape[0]), -SHIFT * order
            try:
                own = eigsh(K, count + 1, M, sigma=shift, v0=first, return_eigenvectors=False)
            except RuntimeError as error:  # singular factorisation, or no convergence
                raise NotCertified(f"the relaxation rates were not found: {error}") from None
            found.append(np.sort(own)[1:])
        answer, (rates, better) = pair[0], found
        common = 2.0 * answer.coefficient_error()
        common += ROUNDINGS * EPS * (answer.count + answer.log_range)
        errors = DISTANCE_FACTOR * np.abs(rates - better) + common * rates
        # Round-off of the largest eigenvalue of the inverse, as an error of each λ.
        errors += ROUNDINGS * EPS * (rates + SHIFT * order) ** 2 / (SHIFT * order)
        if (errors <= tol * rates).all() or 2 * answer.count > chain.MOST_ELEMENTS:
            break
    # The constant is an eigenfunction of 0 on any elements, as no probability is lost. The count
    # shows that no rate was missed.
    beyond = rates[-1] + max(float(errors[-1]), tol * float(rates[-1]))
    below = eigenvalues_below(answer, np.array([0.5 * rates[0], beyond]))
    residual = float(below.tolist() != [1, count + 1])
    settings = {"elements": answer.count, "tol": tol}
    return certify_rates(rates, errors, tol=tol, residual=residual, settings=settings)
