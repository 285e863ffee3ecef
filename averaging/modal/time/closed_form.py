"""Modal energies in time in closed form: independent square-root processes, Eqs. (17), (33).

It holds without contact and with constant damping. Densities of displacements and momenta, Eqs.
(30), (35): a square-root process of the shape n that starts at H_0 is ½|z|² of z = a e + √θ_t ξ in
2n dimensions, e uniform on the unit sphere, ξ standard normal, a² = 2 H_0 e^(−ct), θ_t = θ (1 −
e^(−ct)). Both averaging theories take the state at a given energy as uniform on its sphere. So
linear coordinates x = V z have E e^(i s·x) = Π exp(−½ θ_t s·C s) Λ_n(a √(s·C s)), C = V Vᵀ, a
product over independent energies, Λ_n(z) = Γ(n) (2/z)^(n−1) J_(n−1)(z); Λ_1 = J0.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import pi, prod

import numpy as np
from scipy.special import hyp0f1, j0

from averaging.gaussian import GAUSSIAN_REACH, state_rows
from averaging.modal.analysis import ModalAnalysis
from averaging.modal.observables import fourier_sum, product_of
from averaging.time import modal_limits, modes_of_observable
from fpk.answer.certificate import Measured, certify
from fpk.answer.dynamics import (
    Passage,
    Rates,
    Transient,
    certify_passage,
    certify_rates,
    require_times,
)
from fpk.answer.quantities import Number
from fpk.answer.question import Asked
from fpk.numeric.arrays import BLOCK_SIZE, EPS, LARGEST_LOG, ROUNDINGS, SMALLEST, Array
from fpk.numeric.errors import NotApplicable
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.square_root import SquareRoot
from fpk.system.modulation import Modulation

SUM_PANELS, SUM_POINTS = 16, (20, 24)
"""Panels along H1 + H2 = H, and Gauss points on each, of the comparison and of the answer."""
DECAY_PANELS, DECAY_POINTS = 80, (14, 18)
"""Panels of ∫ P(T > t) dt, equal in ln t, and Gauss points on each, of the comparison and of the
answer."""
EARLY, SETTLED = 1e-13, 60.0
"""Ends in time of the ``DECAY_PANELS``, in units of 1/rate, the mean time of rare failures."""
MOST_WAVES = {1: 400_000, 2: 1_000_000}
"""Largest number of waves in the Fourier series of a density, by its number of coordinates (q, p);
they take seconds for each time."""
DensityOf = Callable[[Array], tuple[Array, Array]]
Passing = tuple[SquareRoot, float, float]
"""The process of an energy, its limit, and its initial value."""
Orbit = tuple[SquareRoot, float, Array]
"""The process of an independent energy, its initial value, and the covariance C (count, count) of
its contribution to the coordinates in the stationary state of temperature 1."""


def transient(modes: ModalAnalysis, asked: Asked) -> Transient:
    """Return the densities of modal energies, of their sum H or of (q, p), Eq. (35).

    The start of ``asked`` is an ``EnergyStart``. Raises ``NotApplicable`` for damping terms, and
    for H of more than two modes of unequal damping or noise; otherwise as ``orbit_transient``.
    """
    observable, start, modulation = asked.observable, asked.start, asked.system.modulation
    every = [(_mode(modes, m, modulation), H) for m, H in enumerate(start.energies.tolist())]
    if {c.kind for c in observable} <= {"q", "p"}:
        # Covariances of the contributions of the modes to (q, p) = S (ω Q, P).
        S = modes.state_shapes[state_rows(observable, modes.n)].reshape(len(observable), 2, modes.n)
        shares = np.einsum("ixm,jxm->mij", S, S)
        return orbit_transient([(*own, C) for own, C in zip(every, shares, strict=True)], asked)
    require_times(asked.times, positive=start.noise is None)
    rows = modes_of_observable(observable)
    parts = [every[m] for m in rows or range(modes.n)]
    if not rows and (total := _equal_modes(modes, modulation)):
        parts = [(total, float(start.energies.sum()))]
    if len(parts) > max(len(rows), 2):
        raise NotApplicable(
            "the sum of more than two modal energies that are not alike is not given"
        )
    return energy_transient(parts, asked)


def energy_transient(parts: Sequence[tuple[SquareRoot, float]], asked: Asked) -> Transient:
    """Return the densities of independent energies, or of the sum of two.

    ``parts`` are the processes and the initial values of the energies; there is a sum if the
    ``asked.observable`` has fewer coordinates. The start of ``asked`` is an ``EnergyStart``. Raises
    ``InvalidInput`` if, from an energy, no noise has acted before one of the times.
    """
    start, times, at = asked.start, asked.times, asked.at
    values, errors = np.empty((2, times.size, at[0].size))
    worst = np.zeros(2)  # largest L1 error and largest defect of the mass
    for k, t in enumerate(times.tolist()):
        each = [partial(mode.density, H, start.noise, t) for mode, H in parts]
        if len(parts) == len(at):
            values[k], errors[k] = product_of(part(x) for part, x in zip(each, at, strict=True))
        else:
            values[k], errors[k] = _convolution(each, at[0])
        own = [mode.judged(H, start.noise, t) for mode, H in parts]
        worst = np.maximum(worst, np.sum(own, axis=0))
    highest = np.max(errors / np.max(values, axis=1, initial=SMALLEST, keepdims=True), initial=0.0)
    l1, defect = float(np.max([worst[0], highest])), float(worst[1])
    measured = Measured(l1, defect, float(values.min(initial=0.0)), None, None)
    certificate = certify(measured, tol=asked.tol)
    return Transient(times, values, errors + SMALLEST, "numerical", certificate)


def passage(modes: ModalAnalysis, asked: Asked) -> Passage:
    """Return the first passage of one modal energy, of the first of several, or of their sum.

    Raises ``NotApplicable`` for damping terms, for a stationary start, and for the sum of modes of
    unequal damping or noise; otherwise as ``modal_limits``.
    """
    start, times, tol = asked.start, require_times(asked.times), asked.tol
    limits, energies = modal_limits(asked.limit, start), start.known()
    parts = [(_mode(modes, m), a, float(energies[m])) for m, a in limits.items()]
    if not limits:
        if (total := _equal_modes(modes)) is None:
            raise NotApplicable(
                "of modes of unequal decay or temperature H has no closed form in time; use fem"
            )
        parts = [(total, asked.limit.value, float(energies.sum()))]
    if len(parts) == 1:
        ((mode, a, H),) = parts
        return mode.passage(a, H, times, tol=tol)
    rates = [mode.rate(a) for mode, a, _ in parts]
    rate = Number(sum(r.value for r in rates), sum(r.error for r in rates))
    survival, lost = _survival(parts, times, tol)
    mean, variance = _first_of(parts, rate.value, tol)
    return certify_passage((mean, variance, rate), times, 1.0 - survival, lost, tol=tol)


def relaxation(modes: ModalAnalysis, count: int, *, tol: float) -> Rates:
    """Return the ``count`` smallest sums Σ k_i c*_ii > 0, k_i = 0, 1, …

    ``tol`` is the relative tolerance. Raises ``NotApplicable`` for damping terms.
    """
    rates = np.zeros(1)
    for m in range(modes.n):
        multiples = _mode(modes, m).c * np.arange(count + 1.0)
        rates = np.sort(np.add.outer(rates, multiples).ravel())[: count + 1]
    return certify_rates(rates[1:], (modes.relative_error + 4.0 * EPS) * rates[1:], tol=tol)


def _mode(modes: ModalAnalysis, m: int, modulation: Modulation | None = None) -> SquareRoot:
    """Return the process of H_m (0-based ``m``); raise ``NotApplicable`` for damping terms."""
    if not modes.constant:
        raise NotApplicable("damping that depends on the state has no closed form in time; use fem")
    c, d = float(modes.modal_damping[m, m]), float(modes.noise[m])
    error = modes.relative_error + (LARGEST_LOG * EPS if modulation else 0.0)
    return SquareRoot(1, c, d, error, modulation)


def _equal_modes(modes: ModalAnalysis, modulation: Modulation | None = None) -> SquareRoot | None:
    """Return the process of the sum of all H_m if damping and noise are equal, else None.

    A relative difference up to 1e-12, plus four times the round-off of the modes, is accepted and
    counts as an error.
    """
    one, c, d = _mode(modes, 0, modulation), np.diag(modes.modal_damping), modes.noise
    unlike = float(max(np.ptp(c) / c[0], np.ptp(d) / d[0]))
    if unlike > 1e-12 + 4.0 * modes.relative_error:
        return None
    return replace(one, n=modes.n, relative_error=one.relative_error + unlike)


def _convolution(parts: Sequence[DensityOf], energy: Array) -> tuple[Array, Array]:
    """Return ∫_0^H p_1(x) p_2(H − x) dx and its error at ``energy`` H (points,), 0 for H < 0."""
    H = np.maximum(energy, 0.0)[:, None]
    nodes = np.sin(np.linspace(0.0, 0.5 * np.pi, SUM_PANELS + 1)) ** 2
    totals = []
    for points in SUM_POINTS:
        s, w = (a.ravel() for a in panel_rule(nodes, points))
        (p, p_error), (r, r_error) = parts[0](H * s), parts[1](H * (1.0 - s))
        totals.append((H[:, 0] * ((p * r) @ w), H[:, 0] * ((p * r_error + p_error * r) @ w)))
    (coarse, _), (fine, own) = totals
    return fine, own + np.abs(fine - coarse)


def _survival(parts: Sequence[Passing], times: Array, tol: float) -> tuple[Array, Array]:
    """Return P(T > t) at ``times``, T the first of independent passages, and its absolute error.

    ``tol`` is the tolerance of P(T <= t) of each passage.
    """
    failures = (mode.failure(a, H, times, tol=tol) for mode, a, H in parts)
    return product_of((1.0 - p, e) for p, e in failures)


def _first_of(parts: Sequence[Passing], rate: float, tol: float) -> tuple[Number, Number]:
    """Return mean and variance of the first of independent passages from ∫S dt and ∫2t S dt.

    S is the product of the survival probabilities, each to ``tol``. Before the panels begin S is
    between its value there and 1; after their end S ~ e^(−``rate`` t).
    """
    ends = np.array([EARLY, SETTLED]) / rate
    nodes = np.log(np.geomspace(ends[0], ends[1], DECAY_PANELS + 1))
    answers = []
    for points in DECAY_POINTS:
        t, w = panel_rule(nodes, points)
        order = np.exp(t.ravel())
        S, lost = _survival(parts, order, tol)
        weights = w.ravel()[:, None] * order[:, None] ** [1, 2] * [1.0, 2.0]
        answers.append((S @ weights, lost @ weights))
    (coarse, _), (fine, own) = answers
    (first, last), _ = _survival(parts, ends, tol)
    beyond = abs(last) / rate * np.array([1.0, 2.0 * (ends[1] + 1.0 / rate)])
    before = ends[0] ** np.array([1, 2])
    mean, square = fine + 0.5 * (1.0 + first) * before
    error, square_error = np.abs(fine - coarse) + own + (1.0 - first) * before + beyond
    variance = Number(float(square - mean**2), float(square_error + 2.0 * mean * error))
    return Number(float(mean), float(error)), variance


def orbit_transient(parts: Sequence[Orbit], asked: Asked) -> Transient:
    """Return the densities of one or two coordinates (q, p), each a sum over ``parts``.

    Raises ``NotApplicable`` if a density is too narrow for ``MOST_WAVES`` waves, ``InvalidInput``
    for the time 0 unless the start is stationary.
    """
    noise, times, at = asked.start.noise, asked.times, asked.at
    require_times(times, positive=noise is None)
    each = [_coordinate_density(parts, noise, t, at) for t in times.tolist()]
    values = np.array([p for p, _, _ in each]).reshape(times.size, at[0].size)
    errors = np.zeros(values.shape) + np.array([floor for _, floor, _ in each])[:, None]
    # The wave of number 0 makes the mass of the box exactly 1; the mass outside it is ``tail``.
    tail, largest = 2.0 * len(at) * EPS, max((floor / top for _, floor, top in each), default=0.0)
    least = min((float(p.min(initial=0.0)) / top for p, _, top in each), default=0.0)
    measured = Measured(largest + tail, tail, least, None, tail, absolute_error=largest)
    settings: dict[str, str | float | int] = {"equation": "characteristic function"}
    certificate = certify(measured, tol=asked.tol)
    return Transient(times, values, errors + SMALLEST, "numerical", certificate, settings)


def _coordinate_density(
    parts: Sequence[Orbit], noise: float | None, t: float, at: tuple[Array, ...]
) -> tuple[Array, float, float]:
    """Return p (points,) at ``at`` and time ``t``, a bound of all its errors, and a height.

    The height is the maximum of a Gaussian density of equal covariance. p is a Fourier series on a
    box of coordinates whose Gaussian part is standard normal; periodic copies, and waves beyond
    ``GAUSSIAN_REACH``, are below round-off. ``noise`` is the factor on the noise of a stationary
    start, None: a known start.
    """
    count = len(at)
    scales = [process.scales(start, noise, t) for process, start, _ in parts]
    spread = sum(theta * C for (theta, _), (*_, C) in zip(scales, parts, strict=True))
    sizes = np.sqrt(np.diag(spread))
    factor = np.linalg.cholesky(spread / np.multiply.outer(sizes, sizes))
    whitened = np.linalg.inv(factor) / sizes
    orbits = [
        (process.n, 2.0 * left * (whitened @ C @ whitened.T))
        for (_, left), (process, _, C) in zip(scales, parts, strict=True)
    ]
    radii = np.sqrt([np.diag(orbit) for _, orbit in orbits])
    box = radii.sum(axis=0) + GAUSSIAN_REACH
    K, M = np.pad(np.ceil(GAUSSIAN_REACH * box / pi).astype(int), (0, 2 - count))
    if np.prod([2.0 * K + 1.0, 2.0 * M + 1.0]) > 2.0 * MOST_WAVES[count]:
        raise NotApplicable(
            f"at the time {t:g} the density is too narrow: the first orbit is "
            f"{float(np.max(radii.sum(axis=0))):.2g} times as far as the noise; ask for later times"
        )
    grid = np.mgrid[0 : K + 1, -M : M + 1]
    s = grid[:count] * (pi / box)[:, None, None]
    square = np.sum(s * s, axis=0)
    arguments = [
        np.sqrt(np.maximum(np.einsum("ikm,ij,jkm->km", s, orbit, s), 0.0)) for _, orbit in orbits
    ]
    gauss = np.exp(-0.5 * square) * np.where(grid[0] == 0, 1.0, 2.0) / np.prod(2.0 * box)
    # Λ_n(z) = E exp(i z e_1), e uniform on the unit sphere in 2n dimensions, is 0F1(n; −z²/4).
    wave = gauss * prod(
        j0(z) if n == 1 else hyp0f1(n, -0.25 * z * z)
        for (n, _), z in zip(orbits, arguments, strict=True)
    )
    # Errors: phases count by |φ|, arguments z by |z Λ_n'| <= min(z, 1 + √z), DLMF (10.14.1) and
    # (10.17.3); whitening by the square of its condition.
    turns = sum(np.abs(part) * b for part, b in zip(s, box, strict=True))
    argued = sum(np.minimum(z, 1.0 + np.sqrt(z)) for z in arguments)
    relative = max(process.relative_error for process, *_ in parts)
    elapsed = max(process.c for process, *_ in parts) * t
    rounded = np.abs(wave) * ROUNDINGS * turns + gauss * ROUNDINGS * (2.0 + argued + square)
    model = 4.0 * relative * gauss * (1.0 + square + (1.0 + elapsed) * argued)
    condition = float(np.linalg.cond(factor)) ** 2
    floor = float(np.sum(EPS * condition * rounded + model)) + 4.0 * count * EPS
    phases = np.pad(pi * whitened / box[:, None], (0, 2 - count))
    chunks = np.array_split(np.array(at), 1 + at[0].size * sum(wave.shape) // BLOCK_SIZE, axis=1)
    p = np.concatenate([fourier_sum(phases, wave[None], *chunk)[0] for chunk in chunks])
    jacobian = abs(float(np.linalg.det(whitened)))
    total = np.eye(count) + sum(orbit / (2.0 * n) for n, orbit in orbits)
    height = (2.0 * pi) ** (-0.5 * count) * jacobian / np.sqrt(float(np.linalg.det(total)))
    return p * jacobian, floor * jacobian, height
