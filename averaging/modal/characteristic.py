"""From the modal energies to displacements and momenta by their characteristic function, (35)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0

from averaging.modal.analysis import ModalAnalysis
from averaging.modal.groups import POINTS, joined
from fpk.density import Density, certified_density
from fpk.observable import Observable
from fpk.quadrature import panel_rule

Array = NDArray[np.float64]

FIRST_BAND = 8.0
"""Wave number, in units of 1/rms, at which the search for the band begins: e^-32 for a Gaussian."""
WIDER = 2.0**0.5
"""Factor by which the band is widened at a time."""
MOST_WAVES = 40_000
"""Waves beyond which the band is not widened; what is cut off goes into the error."""
BEYOND = 3.0
"""What lies beyond the band over what lies in its last ring [s/√2, s]: 1/(√2 − 1) for s^-2."""
PHASE = {1: 30.0, 2: 16.0}
"""Radians over a panel that the rules of ``fpk.density`` (20 and 12 points) meet to 1e-9, by the
number of coordinates."""
HALF_PANELS = (4.0, 400.0)
"""Least and largest number of panels on either side of 0."""
LATTICE = 65
"""Points along an axis at which the largest density and error are read off."""
CHUNK = 4_000_000
"""Numbers held at once: 32 MB."""
EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class _Waves:
    """Sum of waves on the box |y_a| < π/step_a of whitened coordinates, where it is periodic.

    ``characteristic`` (2, k = 0 .. K, l = −L .. L) of p and of its error; of one coordinate L = 0.
    ``cut_off`` bounds what is missing of p.
    """

    steps: Array
    counts: tuple[int, int]
    characteristic: Array
    cut_off: float = 0.0

    def __call__(self, y: Array) -> Array:
        """p and its error (2, points) at points y (2, points), a density of y."""
        first, place = np.unique(y[0], return_inverse=True)
        k = np.arange(self.counts[0] + 1)
        weighted = self.characteristic * self.weight[:, None]
        rows = np.exp(1j * np.multiply.outer(first, self.steps[0] * k)) @ weighted
        m = self.steps[1] * np.arange(-self.counts[1], self.counts[1] + 1)
        total = np.empty((2, y[0].size))
        step = max(CHUNK // m.size, 1)
        for start in range(0, y[0].size, step):
            part = slice(start, start + step)
            other = np.exp(1j * np.multiply.outer(y[1][part], m))
            total[:, part] = np.einsum("cxl,xl->cx", rows[:, place[part]], other).real
        return total

    @property
    def weight(self) -> Array:
        """Area of a wave over (2π)^d, twice for k > 0: k and −k are stored once (K + 1,)."""
        once = np.where(np.arange(self.counts[0] + 1) == 0, 1.0, 2.0)
        return np.asarray(once * np.prod(self.steps / (2.0 * np.pi)))

    @property
    def ring(self) -> Array:
        """Which waves lie in the outermost ring of the band, [1/√2, 1] of it, (K + 1, 2L + 1)."""
        k, m = np.arange(self.counts[0] + 1), np.arange(-self.counts[1], self.counts[1] + 1)
        size = np.maximum(k[:, None] / self.counts[0], np.abs(m) / max(self.counts[1], 1))
        return np.asarray(size > 1.0 / WIDER)

    @property
    def beyond(self) -> float:
        """L1 norm of what lies beyond the band, from its outermost ring.

        ∫|·| over the box is at most √Σ|φ|², by Parseval and Cauchy-Schwarz.
        """
        counted = self.ring * np.where(np.arange(self.counts[0] + 1) == 0, 1.0, 2.0)[:, None]
        return BEYOND * float(np.sqrt(np.sum(counted * self.characteristic[0] ** 2)))


def state_density(
    modes: ModalAnalysis, groups: Sequence[Density], observable: Observable, *, tol: float
) -> Density:
    """Return the density of one or two displacements and momenta from that of the energies.

    An observed x is Σ_m √H_m (U_m cos φ_m + W_m sin φ_m), with X = T Q (14) and p_i = m_i Ẋ_i, and
    the phases are independent and uniform:
    ``E e^{i s·x} = Π_groups E Π_m J0(√H_m |(s·U_m, s·W_m)|)``, smooth at H = 0 as J0 is even.
    The support is bounded, so a sum over waves of that period has no aliasing error at all; what
    lies beyond the band is estimated from its outermost ring, by Parseval's equation. The
    transform itself does not increase an L1 error.
    Coordinates are made uncorrelated first, so that one band does for both.
    """
    U, W = wave_vectors(modes, observable)
    mean, furthest = np.zeros(modes.n), np.zeros(modes.n)
    for group in groups:
        axes, shares, _ = _on_grid(group, [POINTS] * len(group.panels))
        for k, m in enumerate(_modes_of(group)):
            others = tuple(axis for axis in range(len(axes)) if axis != k)
            mean[m] = float(np.sum(shares, axis=others) @ axes[k])
            furthest[m] = np.sqrt(group.panels[k][-1])
    L = np.linalg.cholesky(0.5 * ((U * mean) @ U.T + (W * mean) @ W.T))
    inverse = np.linalg.inv(L)
    vectors = inverse @ U, inverse @ W
    box = np.hypot(*vectors) @ furthest
    waves = _waves(groups, vectors, box, 0.1 * tol)
    area = float(np.prod(np.diag(L)))

    def both(x: Sequence[Array]) -> Array:
        points = np.array(np.broadcast_arrays(*x), dtype=float)
        y = inverse @ points.reshape(len(x), -1)
        inside = np.all(np.abs(y) <= box[:, None], axis=0)
        pair = np.vstack([y, np.zeros((2 - len(x), y.shape[1]))])
        values = np.where(inside, waves(pair), 0.0) / area
        return np.asarray(values.reshape(2, *points.shape[1:]))

    own = modes.relative_error * 2.0 * len(observable)  # of T and ω, in the coordinates
    relative = sum(group.l1_error for group in groups) + own
    round_off = EPS * waves.characteristic[0].size ** 0.5 * 8.0
    floor = waves.cut_off / area
    floor += round_off * float(np.max(np.abs(both([np.zeros(1)] * len(observable)))))

    def pointwise(*x: Array) -> Array:
        p, error = both(x)
        return np.asarray(np.abs(error) + relative * np.abs(p) + floor)

    extent = np.hypot(U, W) @ furthest
    highest = (waves.steps * waves.counts)[: len(observable)] @ np.abs(inverse)
    lattice = [np.linspace(-e, e, LATTICE) for e in extent]
    values, errors = both(np.meshgrid(*lattice, indexing="ij", sparse=True))
    measured = joined(groups, own + waves.beyond + round_off)
    absolute = (floor + float(np.max(np.abs(errors)))) / float(values.max())
    # Panels over which the phase at the edge of the band, where next to nothing is left, turns by
    # ``PHASE``, and no more of them than are affordable.
    halves = np.ceil(np.clip(extent * highest / PHASE[len(observable)], *HALF_PANELS)).astype(int)
    return certified_density(
        observable,
        tuple(np.linspace(-e, e, 1 + 2 * half) for e, half in zip(extent, halves, strict=True)),
        lambda *x: both(x)[0],
        pointwise,
        measured=replace(measured, absolute_error=absolute),
        tol=tol,
    )


def _modes_of(group: Density) -> list[int]:
    return [c.index or 0 for c in group.observable]


def _on_grid(group: Density, points: Sequence[int]) -> tuple[list[Array], Array, Array]:
    """Gauss energies along each axis, and p and its error there times the weights."""
    rules = [panel_rule(x, n) for x, n in zip(group.panels, points, strict=True)]
    axes = [x.ravel() for x, _ in rules]
    weights = reduce(np.multiply.outer, [w.ravel() for _, w in rules])
    p, error = group.at(*np.meshgrid(*axes, indexing="ij", sparse=True))
    return axes, p * weights, error * weights


def wave_vectors(modes: ModalAnalysis, observable: Observable) -> tuple[Array, Array]:
    """Return U and W (observed, n) of x = Σ_m √H_m (U_m cos φ_m + W_m sin φ_m)."""
    U, W = np.zeros((len(observable), modes.n)), np.zeros((len(observable), modes.n))
    for k, coordinate in enumerate(observable):
        i = coordinate.index or 0
        if coordinate.kind == "q":
            U[k] = np.sqrt(2.0) * modes.mode_shapes[i] / modes.natural_frequency
        else:
            W[k] = -np.sqrt(2.0) * modes.momentum_shapes[i]  # p = T⁻ᵀ Q̇
    return U, W


def _waves(
    groups: Sequence[Density], vectors: tuple[Array, Array], box: Array, tol: float
) -> _Waves:
    """Widen the band until what lies beyond it is below ``tol`` in L1."""
    # One coordinate is a pair of which the other has the wave number 0 alone.
    steps = np.append(np.pi / box, [2.0 * np.pi] * (2 - box.size))
    pair = [np.pad(v, ((0, 2 - box.size), (0, 0))) for v in vectors]
    band = FIRST_BAND
    while True:
        reach = np.ceil(band / steps) * [1, box.size - 1]
        counts = int(reach[0]), int(reach[1])
        waves = _Waves(steps, counts, _characteristic(groups, pair, steps, counts))
        if waves.beyond <= tol or np.prod(2.0 * WIDER * reach + 1.0) > MOST_WAVES:
            break
        band *= WIDER
    missing = np.sum(np.abs(waves.characteristic[0]) * waves.ring * waves.weight[:, None])
    return replace(waves, cut_off=BEYOND * float(missing))


def _characteristic(
    groups: Sequence[Density], vectors: Sequence[Array], steps: Array, counts: tuple[int, int]
) -> Array:
    """φ at all waves, (2, K + 1, 2L + 1): of p, and Σ over groups of its error times the rest."""
    along = np.arange(counts[0] + 1), np.arange(-counts[1], counts[1] + 1)
    waves = np.array([x.ravel() for x in np.meshgrid(*along, indexing="ij")]).T * steps
    size = np.hypot(*(waves @ v for v in vectors))  # (waves, n)
    phi, doubt = np.ones(len(waves)), np.zeros(len(waves))
    for group in groups:
        own, error = _of_group(group, size[:, _modes_of(group)])
        doubt = doubt * own + phi * error
        phi = phi * own
    return np.stack([phi, doubt]).reshape(2, counts[0] + 1, -1)


def _of_group(group: Density, size: Array) -> tuple[Array, Array]:
    """E Π J0(size_m √H_m) and its error, (waves,), by Gauss rules that follow the phase."""
    points = []
    for nodes, z in zip(group.panels, size.T, strict=True):
        phase = float(np.max(np.diff(np.sqrt(nodes)))) * float(z.max(initial=0.0))
        points.append(POINTS + 4 * int(np.ceil(0.15 * phase)))
    axes, shares, errors = _on_grid(group, points)
    masses = np.stack([shares, errors])
    total = np.empty((2, size.shape[0]))
    step = max(CHUNK // sum(x.size for x in axes), 1)
    for start in range(0, size.shape[0], step):
        part = slice(start, start + step)
        bessel = [
            j0(np.multiply.outer(z, np.sqrt(x))) for z, x in zip(size[part].T, axes, strict=True)
        ]
        if len(bessel) == 1:
            total[:, part] = masses @ bessel[0].T
        else:
            total[:, part] = np.einsum("cwx,wx->cw", bessel[0] @ masses, bessel[1])
    return total[0], total[1]
