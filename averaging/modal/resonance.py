"""Internal resonance: what averaging over the phases of the modes neglects, section 5."""

from dataclasses import dataclass
from itertools import combinations, combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from averaging.modal.analysis import ModalAnalysis

Array = NDArray[np.float64]

ORDER = 4
"""Σ|l_i| up to which resonances are searched. Averages of v_i v_j hold the frequencies
ω_i ± ω_j, order 2; damping that is quadratic in the state multiplies them to order 4."""
MOST_CORRELATED = 0.1
"""Largest correlation of two modes that averaging may neglect: p(q_i, p_j) is then off by up to
about 2/π of it in L1, p(q_i) by the order of its product with bandwidth/detuning."""


@dataclass(frozen=True)
class Resonance:
    """Integers l that make ``detuning`` |Σ l_i ω_i| smallest, 0 < Σ|l_i| <= an order asked for.

    ``bandwidth`` Σ |l_i| c*_ii/(2 M*_i) is the rate at which the phase Σ l_i φ_i is forgotten.
    With constant damping only 1:1 resonances, l = e_i − e_j, move energy; see ``ModePair``.
    """

    integers: tuple[int, ...]
    detuning: float
    bandwidth: float

    @property
    def ratio(self) -> float:
        """Bandwidth over detuning: what averaging takes for small."""
        return self.bandwidth / self.detuning if self.detuning > 0 else float("inf")

    def __str__(self) -> str:
        """Return the relation in words."""
        integers = ", ".join(map(str, self.integers))
        return (
            f"|Σ l ω| = {self.detuning:.4g} for l = ({integers}), against the bandwidth "
            f"{self.bandwidth:.4g}"
        )


@dataclass(frozen=True)
class ModePair:
    """Two modes (counted from 0) and the correlation of theirs that averaging neglects.

    ``detuning`` |ω_i − ω_j|; ``bandwidth`` the sum of the half-bandwidths; ``correlation`` the
    largest stationary correlation coefficient between displacement and velocity of one mode and
    those of the other, to first order in the coupling.
    """

    modes: tuple[int, int]
    detuning: float
    bandwidth: float
    correlation: float


def nearest_resonance(modes: ModalAnalysis, *, order: int = ORDER) -> Resonance:
    """Return the internal resonance of least detuning up to an even order, Σ|l_i| <= 4 by default.

    Every such l is the difference of two vectors of half that order; their frequencies are sorted,
    and the least difference is one of neighbours, so that many modes cost little.
    """
    modes = modes.linearised
    halves = integer_vectors(modes.n, order // 2)
    frequency = halves @ modes.natural_frequency
    ranked = np.argsort(frequency, kind="stable")
    closest = int(np.argmin(np.diff(frequency[ranked])))
    integers = halves[ranked[closest + 1]] - halves[ranked[closest]]
    integers *= np.sign(integers[np.flatnonzero(integers)[0]])
    return Resonance(
        integers=tuple(int(i) for i in integers),
        detuning=abs(float(integers @ modes.natural_frequency)),
        bandwidth=float(np.abs(integers) @ modes.half_bandwidth),
    )


def integer_vectors(n: int, order: int) -> NDArray[np.int64]:
    """All integer vectors (…, n) with Σ|l_i| <= ``order``, each once."""
    units = np.concatenate([np.eye(n, dtype=np.int64), -np.eye(n, dtype=np.int64)])
    units = np.concatenate([units, np.zeros((1, n), dtype=np.int64)])
    chosen = combinations_with_replacement(range(2 * n + 1), order)
    return np.unique([units[list(c)].sum(axis=0) for c in chosen], axis=0)


def mode_pairs(modes: ModalAnalysis) -> tuple[ModePair, ...]:
    """Return all pairs of modes with the correlation that averaging neglects.

    In coordinates of unit modal mass the cross terms of the Lyapunov equation are driven by
    ``S = 2 D_ij − c_ij θ_j − c_ji θ_i``. With Δ = ω_i² − ω_j², w = c_ii ω_j² + c_jj ω_i² and
    N = Δ² + (c_ii + c_jj) w they are, to first order in S,
    ``E Q_i V_j = S Δ/N``, ``E Q_i Q_j = S (c_ii + c_jj)/N``, ``E V_i V_j = S w/N``: of relative
    order bandwidth/detuning between displacement and velocity and its square otherwise. S
    vanishes for equal temperatures with D_ij = θ c_ij (symmetric part), where a resonance is
    therefore harmless; equal temperatures alone do not make it so. Damping that depends on the
    state enters as its statistical linearisation.
    """
    modes = modes.linearised
    scale = np.sqrt(np.outer(modes.modal_mass, modes.modal_mass))
    c, D = modes.modal_damping / scale, modes.modal_noise / scale
    w, theta = modes.natural_frequency, modes.temperature
    pairs = []
    for i, j in combinations(range(modes.n), 2):
        source = abs(2.0 * D[i, j] - c[i, j] * theta[j] - c[j, i] * theta[i])
        gap = float(abs(w[i] - w[j]) * (w[i] + w[j]))
        width = float(c[i, i] + c[j, j])
        weight = float(c[i, i] * w[j] ** 2 + c[j, j] * w[i] ** 2)
        largest = max(max(w[i], w[j]) * gap, w[i] * w[j] * width, weight)
        correlation = source / np.sqrt(theta[i] * theta[j]) * largest / (gap**2 + width * weight)
        bandwidth = float(modes.half_bandwidth[i] + modes.half_bandwidth[j])
        pairs.append(ModePair((i, j), float(abs(w[i] - w[j])), bandwidth, float(correlation)))
    return tuple(pairs)


def strongest_pair(modes: ModalAnalysis) -> ModePair | None:
    """Return the pair of modes whose neglected correlation is largest; None for one mode."""
    return max(mode_pairs(modes), key=lambda pair: pair.correlation, default=None)


def resonance_refusal(modes: ModalAnalysis) -> str | None:
    """Return why the modes may not be averaged one by one, or None where they may.

    With constant damping only pairs matter, and only by the correlation that is neglected: a
    resonance of higher order, or of modes that nothing drives together, does no harm.
    """
    pair = strongest_pair(modes)
    if pair is None or pair.correlation <= MOST_CORRELATED:
        return None
    i, j = (k + 1 for k in pair.modes)
    return (
        f"internal resonance: |ω{i} − ω{j}| = {pair.detuning:.4g} is not large against the "
        f"half-bandwidths' sum {pair.bandwidth:.4g}; averaging would neglect a correlation of "
        f"{pair.correlation:.2g} between these modes, at most {MOST_CORRELATED:g} is allowed"
    )
