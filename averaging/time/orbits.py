"""Displacements and momenta in time whose energies are square-root processes, Eqs. (30), (35).

A square-root process of the shape n, from H_0, is ½|z|² of z = a e + √θ_t ξ in 2n dimensions: e is
uniform on the unit sphere, ξ standard normal, a² = 2 H_0 e^(−ct) and θ_t = θ (1 − e^(−ct)). With
the state at a given energy uniform on its sphere, as both averagings say, the linear coordinates
x = V z have E e^(i s·x) = Π exp(−½ θ_t s·C s) Λ_n(a √(s·C s)), C = V Vᵀ, over independent energies,
Λ_n(z) = Γ(n) (2/z)^(n−1) J_(n−1)(z). For n = 1 that is J0 of a uniform phase.
"""

from collections.abc import Sequence
from math import exp, pi, prod

import numpy as np
from scipy.special import hyp0f1, j0

from averaging.modal.characteristic import FourierSeries
from averaging.time.start import DensityQuestion
from fpk.arrays import CHUNK, EPS, SMALLEST, Array
from fpk.certificate import Measured, certify
from fpk.errors import NotApplicable
from fpk.evolution import Transient, checked_times
from fpk.square_root import SquareRoot

REACH = 9.0
"""Standard deviations up to which a Gaussian counts, of the coordinates and of the waves."""
BEYOND = exp(-0.5 * REACH**2)
"""A standard normal density at ``REACH``, relative to its maximum: 3e-18."""
MOST_WAVES = {1: 400_000, 2: 1_000_000}
"""Largest number of waves, by the number of coordinates: seconds for each time."""
ROUNDINGS = 4.0
"""Roundings of each radian of the phase of a wave, and of the arguments of its factors."""


Orbit = tuple[SquareRoot, float, Array]
"""One of the independent energies whose orbits add up to the coordinates: its process, where it
begins, and the covariance C (count, count) of its share of the coordinates in the stationary state
of temperature 1."""


def orbit_transient(parts: Sequence[Orbit], asked: DensityQuestion) -> Transient:
    """Return the densities at times > 0 of one or two coordinates, the sum of ``parts``.

    From the start of each part, or the stationary state under the noise of the start. Raises
    ``NotApplicable`` where an orbit is too thin for ``MOST_WAVES``.
    """
    noise, times, at = asked.start.noise, asked.times, asked.at
    checked_times(times, positive=noise is None)
    values, errors = np.empty((2, times.size, at[0].size))
    largest, least = 0.0, 0.0
    for k, t in enumerate(times.tolist()):
        values[k], errors[k], height = _density(parts, noise, t, at)
        largest = max(largest, float(errors[k].max(initial=0.0)) / height)
        least = min(least, float(values[k].min(initial=0.0)) / height)
    # Of waves on a box the mean is 1 exactly: the mass is that of the box, but for what is beyond.
    tail = 2.0 * len(at) * BEYOND
    measured = Measured(largest + tail, tail, least, None, tail, absolute_error=largest)
    return Transient(
        times, values, errors + SMALLEST, "numerical", certify(measured, tol=asked.tol),
        {"equation": "characteristic function"},
    )  # fmt: skip


def _density(
    parts: Sequence[Orbit], noise: float | None, t: float, at: tuple[Array, ...]
) -> tuple[Array, Array, float]:
    """p at the points, its error, and the height of the Gaussian of the same covariance.

    In coordinates y whose Gaussian part is standard normal, as a Fourier series on a box: from its
    copies, and from waves beyond ``REACH``, come ``BEYOND`` each.
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
    box = radii.sum(axis=0) + REACH
    K = np.ceil(REACH * box / pi).astype(int)
    if float(np.prod(2.0 * K + 1.0)) > 2.0 * MOST_WAVES[count]:
        raise NotApplicable(
            f"at the time {t:g} the density is too narrow: the first orbit is "
            f"{float(np.max(radii.sum(axis=0))):.2g} times as far as the noise; ask for later times"
        )
    k, m = (np.arange(low, high) for low, high in ((0, K[0] + 1), (-K[-1], K[-1] + 1)))
    grid = np.meshgrid(k, m if count == 2 else [0], indexing="ij")
    s = np.array([j * pi / b for j, b in zip(grid, box, strict=False)])
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
    # Errors: phases count by |φ|, arguments z by |z Λ_n'| <= min(z, 1 + √z), as DLMF (10.14.1) and
    # (10.17.3) have it; whitening by the square of its condition.
    turns = sum(np.abs(part) * b for part, b in zip(s, box, strict=True))
    argued = sum(np.minimum(z, 1.0 + np.sqrt(z)) for z in arguments)
    relative = max(process.relative_error for process, *_ in parts)
    elapsed = max(process.c for process, *_ in parts) * t
    rounded = np.abs(wave) * ROUNDINGS * turns + gauss * ROUNDINGS * (2.0 + argued + square)
    model = 4.0 * relative * gauss * (1.0 + square + (1.0 + elapsed) * argued)
    condition = float(np.linalg.cond(factor)) ** 2
    floor = float(np.sum(EPS * condition * rounded + model)) + 4.0 * count * BEYOND
    pad = 0, 2 - count
    series = FourierSeries(np.pad(pi * whitened / box[:, None], pad), wave[None])
    chunks = np.array_split(np.array(at), 1 + at[0].size * sum(wave.shape) // CHUNK, axis=1)
    p = np.concatenate([series(*chunk)[0] for chunk in chunks])
    jacobian = abs(float(np.linalg.det(whitened)))
    total = np.eye(count) + sum(orbit / (2.0 * n) for n, orbit in orbits)
    height = (2.0 * pi) ** (-0.5 * count) * jacobian / np.sqrt(float(np.linalg.det(total)))
    return p * jacobian, np.full(p.shape, floor * jacobian), height
