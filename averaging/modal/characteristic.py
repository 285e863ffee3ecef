"""Densities of displacements and momenta from those of the modal energies, Eq. (35)."""

from collections.abc import Iterable, Sequence
from functools import partial, reduce
from math import prod

import numpy as np
from scipy.special import j0

from averaging.gaussian import state_rows
from averaging.modal.analysis import ModalAnalysis
from fpk.answer.certificate import Measured, outside, worst
from fpk.answer.density import Density, certified_density
from fpk.answer.names import Observable
from fpk.numeric.arrays import CHUNK, EPS, Array
from fpk.numeric.quadrature import panel_rule

POINTS = 24
"""Gauss points per panel where an energy is integrated out: over three e-folds they miss 1e-30."""
FIRST_BAND = 8.0
"""Highest wave number of the first attempt, in units of 1/rms: φ of a Gaussian is e^-32 there."""
WIDER = 2.0**0.5
"""Factor from one highest wave number s to the next. The norm of φ beyond s is taken for
1/(√2 − 1) of that between s/√2 and s, as where |φ| falls as s^-2."""
MAX_WAVES = 40_000
"""Largest number of waves; the estimate of what further ones would add goes into the error."""
PHASE = {1: 30.0, 2: 16.0}
"""Largest phase over a panel by the number of coordinates: 20 and 12 points integrate to 1e-9."""
HALF_PANELS = (4.0, 400.0)
"""Least and largest number of panels of an axis on either side of 0."""


def fourier_sum(phases: Array, coefficients: Array, x: Array, y: Array | float = 0.0) -> Array:
    """Return Σ_km coefficients_km exp(i (k a_0 + m a_1)) where |a| <= π, else 0, a = ``phases`` x.

    ``phases`` (2, 2) is lower triangular; ``coefficients`` (functions, k = 0 .. K, m = −M .. M)
    have k and −k in one. Points broadcast together; the answer is (functions, ...).
    """
    K, M = np.array(coefficients.shape[1:]) // [1, 2] - [1, 0]
    (u, i), (v, j) = (np.unique(z, return_inverse=True) for z in (x, y))
    k, m = 1j * np.arange(K + 1), 1j * np.arange(-M, M + 1)
    rows = np.exp(np.outer(phases[0, 0] * u, k)) @ coefficients
    rows = rows * np.exp(np.outer(phases[1, 0] * u, m))
    columns = np.exp(np.outer(m, phases[1, 1] * v))
    i, j = np.broadcast_arrays(i.reshape(np.shape(x)), j.reshape(np.shape(y)))
    if u.size * v.size <= 4 * i.size:  # a grid
        total = (rows @ columns).real[:, i, j]
    else:
        total = np.einsum("c...m,m...->c...", rows[:, i], columns[:, j]).real
    a = np.tensordot(phases, np.array(np.broadcast_arrays(x, y)), 1)
    return np.where(np.all(np.abs(a) <= np.pi, axis=0), total, 0.0)


def state_density(
    modes: ModalAnalysis, groups: Sequence[Density], observable: Observable, *, tol: float
) -> Density:
    """Return the density of one or two displacements and momenta from that of the energies.

    An observed x is Σ_m √H_m (U_m cos φ_m + W_m sin φ_m), X = T Q (14) and p_i = m_i Ẋ_i, with
    independent uniform phases: ``E e^{i s·x} = Π_groups E Π_m J0(√H_m |(s·U_m, s·W_m)|)``. A
    Fourier series on the bounded support has no aliasing error; what lies beyond the band is
    estimated from its outermost ring. The transform does not increase an L1 error.
    """
    count = len(observable)
    rows = np.sqrt(2.0) * modes.state_shapes[state_rows(observable, modes.n)]
    U, W = rows[:, : modes.n], rows[:, modes.n :]
    mean, largest = np.zeros(modes.n), np.zeros(modes.n)
    for group in groups:
        for m, x in zip(group.observable, group.panels, strict=True):
            mean[m.row] = group.moment(*(int(other == m) for other in group.observable)).value
            largest[m.row] = np.sqrt(x[-1])
    whitened = np.linalg.inv(np.linalg.cholesky((U * mean) @ U.T / 2 + (W * mean) @ W.T / 2))
    box = np.hypot(whitened @ U, whitened @ W) @ largest
    phases = np.pi * whitened / box[:, None]
    scale = float(np.prod(np.diag(whitened) / (2.0 * box)))
    band, beyond = FIRST_BAND, 1.0 / (WIDER - 1.0)
    while True:  # until the waves beyond the band add less than a tenth of the tolerance
        K, M = np.pad(np.ceil(band * box / np.pi).astype(int), (0, 2 - count))
        k, m = np.mgrid[0 : K + 1, -M : M + 1]
        waves = np.stack([k.ravel(), m.ravel()][:count], axis=1) @ phases
        # E Π_m J0(√H_m size_m), and the transform of its error: that of each group times p of the
        # others.
        size = np.hypot(waves @ U, waves @ W)
        p, error = np.ones(len(size)), np.zeros(len(size))
        for group in groups:
            own, own_error = _of_group(group, size[:, [c.row for c in group.observable]])
            p, error = p * own, error * own + p * own_error
        both_signs = np.where(k == 0, 1.0, 2.0)
        ring = np.abs(p.reshape(k.shape))
        ring *= np.maximum(k / K, np.abs(m) / max(M, 1)) > 1.0 / WIDER
        # ∫|·| over the box is at most √Σ|φ|², by Parseval and Cauchy-Schwarz.
        l1_beyond = beyond * float(np.sqrt(np.sum(both_signs * ring**2)))
        if l1_beyond <= 0.1 * tol or np.prod(2.0 * WIDER * np.array([K, M]) + 1.0) > MAX_WAVES:
            break
        band *= WIDER
    coefficients = scale * both_signs * np.stack([p, error]).reshape(2, *k.shape)
    both = partial(fourier_sum, np.pad(phases, (0, 2 - count)), coefficients)
    from_modes = modes.relative_error * 2.0 * count  # of T and ω, in the coordinates
    relative = sum(group.l1_error for group in groups) + from_modes
    round_off = 8.0 * EPS * float(k.size) ** 0.5
    floor = beyond * scale * float(np.sum(both_signs * ring))
    floor += round_off * float(both(np.zeros(1))[0, 0])

    def pointwise(*x: Array) -> Array:
        p, error = both(*x)
        return np.asarray(np.abs(error) + relative * np.abs(p) + floor)

    extent = np.hypot(U, W) @ largest
    # Panels over which the phase at the edge of the band, where next to nothing is left, turns by
    # ``PHASE``, and no more of them than are affordable.
    turns = extent * (np.array([K, M])[:count] @ np.abs(phases)) / PHASE[count]
    halves = np.ceil(np.clip(turns, *HALF_PANELS)).astype(int)
    return certified_density(
        observable,
        tuple(np.linspace(-e, e, 1 + 2 * half) for e, half in zip(extent, halves, strict=True)),
        lambda *x: both(*x)[0],
        pointwise,
        measured=joined(groups, from_modes + l1_beyond + round_off),
        tol=tol,
    )


def joined(parts: Sequence[Density], added: float = 0.0) -> Measured:
    """Return what was measured on independent densities, for one that depends on them all."""
    checks = [part.certificate for part in parts]
    return Measured(
        l1_error=sum(part.l1_error for part in parts) + added,
        mass_defect=sum(c.mass_defect for c in checks if c.mass_defect is not None),
        minimum=None,
        residual=worst(c.residual for c in checks),
        tail_mass=sum(outside(c) for c in checks),
        net_flux=worst(c.net_flux for c in checks),
        failures=tuple(dict.fromkeys(words for c in checks for words in c.failures)),
    )


def product_of(factors: Iterable[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Return the product of numbers with errors, and its error."""
    value, error = np.ones(1), np.zeros(1)
    for x, e in factors:
        value, error = value * x, error * (np.abs(x) + e) + np.abs(value) * e
    return value, error


def _of_group(group: Density, size: Array) -> Array:
    """E Π J0(√H_m size_m) and its error, (2, waves), by Gauss rules that follow the phase."""
    rules = []
    for nodes, z in zip(group.panels, size.T, strict=True):
        phase = float(np.max(np.diff(np.sqrt(nodes)))) * float(z.max(initial=0.0))
        rules.append(panel_rule(nodes, POINTS + 4 * int(np.ceil(0.15 * phase))))
    energies, weights = ([a.ravel() for a in part] for part in zip(*rules, strict=True))
    shares = reduce(np.multiply.outer, weights) * group.at(
        *np.meshgrid(*energies, indexing="ij", sparse=True)
    )
    shares = shares.reshape(2, energies[0].size, -1)
    total = np.empty((2, len(size)))
    step = max(CHUNK // sum(H.size for H in energies), 1)
    for start in range(0, len(size), step):
        part = slice(start, start + step)
        first, *second = (
            j0(np.multiply.outer(z, np.sqrt(H)))
            for z, H in zip(size[part].T, energies, strict=True)
        )
        total[:, part] = np.sum((first @ shares) * prod(second), axis=2)
    return total
