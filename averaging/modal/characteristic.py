"""From the modal energies to displacements and momenta by their characteristic function, (35)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0

from averaging.modal.analysis import ModalAnalysis
from averaging.modal.blocks import EnergyDensity, joined_checks
from fpk.density import Density
from fpk.observable import Observable

Array = NDArray[np.float64]
Blocks = Sequence[tuple[tuple[int, ...], EnergyDensity]]

FIRST_BAND = 8.0
"""Wave number, in units of 1/rms, at which the search for the band begins: e^-32 for a Gaussian."""
WIDER = 2.0**0.5
MOST_WAVES = 40_000
"""Waves beyond which the band is not widened; what is cut off goes into the error."""
BEYOND = 3.0
"""What lies beyond the band over what lies in its last ring [s/√2, s]: 1/(√2 − 1) for s^-2."""
CHUNK = 4_000_000
EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class _Waves:
    """Sum of waves on the box |y_a| < X_a of whitened coordinates, where it is periodic."""

    steps: tuple[float, ...]
    counts: tuple[int, ...]
    characteristic: Array  # (2, k = 0 .. K, l = −L .. L), of p and of its error
    cut_off: float

    def __call__(self, y: Sequence[Array]) -> Array:
        """p and its error (2, points) at points y_a (points,), a density of y."""
        first, place = np.unique(y[0], return_inverse=True)
        k = np.arange(self.counts[0] + 1)
        once = np.where(k == 0, 1.0, 2.0)
        share = np.prod([step / (2.0 * np.pi) for step in self.steps])
        weighted = self.characteristic * (once * share)[:, None]
        if len(y) == 1:
            waves = np.cos(np.multiply.outer(first, self.steps[0] * k))
            return np.asarray((weighted[..., 0] @ waves.T)[:, place])
        waves = np.exp(1j * np.multiply.outer(first, self.steps[0] * k))
        rows = waves @ weighted  # (2, unique, l)
        m = self.steps[1] * np.arange(-self.counts[1], self.counts[1] + 1)
        total = np.empty((2, y[0].size))
        step = max(CHUNK // m.size, 1)
        for start in range(0, y[0].size, step):
            part = slice(start, start + step)
            other = np.exp(1j * np.multiply.outer(y[1][part], m))
            total[:, part] = np.einsum("cxl,xl->cx", rows[:, place[part]], other).real
        return total


def state_density(
    modes: ModalAnalysis,
    blocks: Blocks,
    observable: Observable,
    *,
    tol: float,
    provenance: Mapping[str, str | float | int],
) -> Density:
    """Return the density of one or two displacements and momenta from that of the energies.

    An observed x is Σ_m √H_m (U_m cos φ_m + W_m sin φ_m), with X = T Q (14) and p_i = m_i Ẋ_i, and
    the phases are independent and uniform:
    ``E e^{i s·x} = Π_blocks E Π_m J0(√H_m |(s·U_m, s·W_m)|)``, smooth at H = 0 as J0 is even.
    The support is bounded, so a sum over waves of that period has no aliasing error at all; what
    lies beyond the band is estimated from its outermost ring, by Parseval's equation. The
    transform itself does not increase an L1 error.
    Coordinates are made uncorrelated first, so that one band does for both.
    """
    U, W = wave_vectors(modes, observable)
    grids = {block: energies.on_grid([24] * len(block)) for block, energies in blocks}
    mean = np.zeros(modes.n)
    for block, (axes, masses) in grids.items():
        for k, m in enumerate(block):
            shape = [-1 if axis == k else 1 for axis in range(len(block))]
            mean[m] = float(np.sum(masses[0] * axes[k].reshape(shape)))
    covariance = 0.5 * ((U * mean) @ U.T + (W * mean) @ W.T)
    L = np.linalg.cholesky(covariance)
    inverse = np.linalg.inv(L)
    furthest = np.zeros(modes.n)
    for block, energies in blocks:
        furthest[list(block)] = [np.sqrt(x[-1]) for x in energies.panels]
    box = np.hypot(inverse @ U, inverse @ W) @ furthest
    waves = _waves(blocks, (inverse @ U, inverse @ W), box, 0.1 * tol)
    l1_error = sum(energies.l1_error for _, energies in blocks)
    relative = l1_error + modes.relative_error
    round_off = EPS * waves.characteristic[0].size ** 0.5 * 8.0
    area = float(np.prod(np.diag(L)))

    def both(x: Sequence[Array]) -> Array:
        points = np.stack(np.broadcast_arrays(*x), axis=-1).astype(float)
        y = points.reshape(-1, len(x)) @ inverse.T
        inside = np.all(np.abs(y) <= box, axis=1)
        found = np.where(inside, waves(list(y.T)), 0.0) / area
        return found.reshape(2, *points.shape[:-1])

    def pointwise(*x: Array) -> Array:
        p, error = both(x)
        floor = waves.cut_off / area + round_off * float(np.max(np.abs(both_at_rest)))
        return np.asarray(np.abs(error) + relative * np.abs(p) + floor)

    both_at_rest = both([np.zeros(1)] * len(observable))
    extent = np.hypot(U, W) @ furthest
    highest = np.array([s * n for s, n in zip(waves.steps, waves.counts, strict=True)]) @ abs(
        inverse
    )
    per_panel = 30.0 if len(observable) == 1 else 16.0
    # Phase over a panel that the rules of ``fpk.density`` (20 and 12 points) meet to 1e-9,
    # relative to the band's edge, where next to nothing is left.
    panels = tuple(
        np.linspace(-e, e, 1 + 2 * int(np.ceil(min(max(e * h / per_panel, 4.0), 400.0))))
        for e, h in zip(extent, highest, strict=True)
    )
    parseval = BEYOND * _ring_norm(waves) + round_off
    checks = joined_checks([energies.certificate for _, energies in blocks])
    error = l1_error + 2.0 * len(observable) * modes.relative_error + parseval
    lattice = [np.linspace(-0.9 * e, 0.9 * e, 65) for e in extent]
    values = both(np.meshgrid(*lattice, indexing="ij", sparse=True))[0]
    checks = replace(checks, minimum=min(checks.minimum, float(values.min() / values.max())))
    if not error <= tol and not checks.failures:
        words = f"the estimated error {error:.2g} exceeds the tolerance {tol:.2g}"
        checks = replace(checks, failures=(words,))
    return Density(observable, panels, lambda *x: both(x)[0], pointwise, error, checks, provenance)


def wave_vectors(modes: ModalAnalysis, observable: Observable) -> tuple[Array, Array]:
    """Return U and W (observed, n) of x = Σ_m √H_m (U_m cos φ_m + W_m sin φ_m)."""
    U, W = np.zeros((len(observable), modes.n)), np.zeros((len(observable), modes.n))
    # p = M T Q̇ = T⁻ᵀ M* Q̇: the momenta without the masses of the chain.
    to_momenta = np.linalg.inv(modes.mode_shapes).T * np.sqrt(2.0 * modes.modal_mass)
    for k, coordinate in enumerate(observable):
        i = coordinate.index or 0
        if coordinate.kind == "q":
            U[k] = modes.mode_shapes[i] * np.sqrt(2.0 / modes.modal_stiffness)
        else:
            W[k] = -to_momenta[i]
    return U, W


def _waves(blocks: Blocks, vectors: tuple[Array, Array], box: Array, tol: float) -> _Waves:
    """Widen the band until what its outermost ring holds is below ``tol``, by Parseval in L1."""
    steps = tuple(float(np.pi / x) for x in box)
    band = FIRST_BAND
    while True:
        counts = tuple(int(np.ceil(band / step)) for step in steps)
        found = _Waves(steps, counts, _characteristic(blocks, vectors, steps, counts), 0.0)
        wider = np.prod([2.0 * WIDER * n + 1 for n in counts])
        if BEYOND * _ring_norm(found) <= tol or wider > MOST_WAVES:
            break
        band *= WIDER
    total = float(np.sum(np.abs(found.characteristic[0]) * _ring(found)))
    area = np.prod([step / (2.0 * np.pi) for step in steps])
    return replace(found, cut_off=float(BEYOND * total * area))


def _ring(waves: _Waves) -> Array:
    """How often each wave of the outermost ring counts (k and −k are stored once), else 0."""
    k = np.arange(waves.counts[0] + 1)
    size = k[:, None] / waves.counts[0]
    if len(waves.counts) == 2:
        m = np.abs(np.arange(-waves.counts[1], waves.counts[1] + 1))
        size = np.maximum(size, m / waves.counts[1])
    return np.asarray((size > 1.0 / WIDER) * np.where(k == 0, 1.0, 2.0)[:, None])


def _ring_norm(waves: _Waves) -> float:
    """√Σ|φ|² over the ring: ∫|·| over the box is at most that, by Parseval and Cauchy-Schwarz."""
    return float(np.sqrt(np.sum(_ring(waves) * waves.characteristic[0] ** 2)))


def _characteristic(
    blocks: Blocks, vectors: tuple[Array, Array], steps: tuple[float, ...], counts: tuple[int, ...]
) -> Array:
    """φ at all waves, (2, K + 1, 2L + 1): of p, and Σ over blocks of its error times the rest."""
    s = steps[0] * np.arange(counts[0] + 1)
    if len(steps) == 1:
        waves = s[:, None]
        shape = (s.size, 1)
    else:
        t = steps[1] * np.arange(-counts[1], counts[1] + 1)
        waves = np.stack([part.ravel() for part in np.meshgrid(s, t, indexing="ij")], axis=1)
        shape = (s.size, t.size)
    size = np.hypot(waves @ vectors[0], waves @ vectors[1])  # (waves, n)
    phi, doubt = np.ones(size.shape[0]), np.zeros(size.shape[0])
    for block, energies in blocks:
        found = _of_block(energies, size[:, list(block)])
        doubt = doubt * found[0] + phi * found[1]
        phi = phi * found[0]
    return np.stack([phi, doubt]).reshape(2, *shape)


def _of_block(energies: EnergyDensity, size: Array) -> Array:
    """E Π J0(size_m √H_m), (2, waves), by Gauss rules that follow the phase over a panel."""
    points = []
    for nodes, z in zip(energies.panels, size.T, strict=True):
        phase = float(np.max(np.diff(np.sqrt(nodes)))) * float(z.max(initial=0.0))
        points.append(24 + 4 * int(np.ceil(0.15 * phase)))
    axes, masses = energies.on_grid(points)
    found = np.empty((2, size.shape[0]))
    step = max(CHUNK // sum(x.size for x in axes), 1)
    for start in range(0, size.shape[0], step):
        part = slice(start, start + step)
        bessel = [
            j0(np.multiply.outer(z, np.sqrt(x))) for z, x in zip(size[part].T, axes, strict=True)
        ]
        if len(bessel) == 1:
            found[:, part] = masses @ bessel[0].T
        else:
            found[:, part] = np.einsum("cwx,wx->cw", bessel[0] @ masses, bessel[1])
    return found
