"""Internal resonance: when averaging over independent phases of the modes fails, section 5."""

from collections.abc import Container
from itertools import combinations_with_replacement
from math import factorial, prod

import numpy as np

from averaging.modal.analysis import ModalAnalysis
from fpk.numeric.arrays import Array, Integers
from fpk.numeric.errors import NotApplicable
from fpk.system.damping import gaussian_moment
from fpk.system.system import System

MIN_ORDER = 4
"""Smallest limit of the order Σ|l_i| of resonances: v_i v_j oscillates with ω_i ± ω_j, of order 2,
and with damping quadratic in the state the order is 4."""
MAX_NEGLECTED = 0.1
"""Largest correlation ρ of two modes, and largest relative oscillation of a modal energy, that
averaging may neglect: the L1 error of p(q_i, p_j) is 2ρ/π, of p(q_i) ρ bandwidth/detuning."""
MAX_CANDIDATES = 500
"""Largest number of resonances examined, in ascending order of the detuning."""


def require_no_resonance(system: System, modes: ModalAnalysis) -> None:
    """Raise ``NotApplicable`` if a resonance forbids to average over the phases of the modes.

    The neglected correlation of two modes may be up to ``MAX_NEGLECTED``. With damping terms this
    holds also for the oscillation of H_m by 2 A/detuning, relative to θ_m, that a power of
    amplitude A and phase Σ l_i φ_i into mode m causes.
    """
    correlation = correlations(modes)
    i, j = np.unravel_index(np.argmax(correlation), correlation.shape)
    if not correlation[i, j] <= MAX_NEGLECTED:
        detuning = abs(float(modes.natural_frequency[i] - modes.natural_frequency[j]))
        raise NotApplicable(
            f"internal resonance: |ω{i + 1} − ω{j + 1}| = {detuning:.4g} is not large against the "
            f"half-bandwidths' sum {modes.half_bandwidth[[i, j]].sum():.4g}; averaging would "
            f"neglect a correlation of {correlation[i, j]:.2g} between these modes, at most "
            f"{MAX_NEGLECTED:g} is allowed"
        )
    terms = system.damping_terms
    sizes = {size for term in terms for size in range(term.factors, 0, -2)} - {2}
    if not sizes or modes.n == 1:
        return
    # At larger detunings the oscillation is allowed even if its amplitude is twice the mean power.
    fastest = float(np.max(np.diag(modes.averaged.mean(modes.temperature)[1])))
    far, order = 4.0 * fastest / MAX_NEGLECTED, resonance_order(system)
    for integers, detuning in resonances(modes.natural_frequency, order, sizes, far):
        swing = 2.0 * flow_amplitudes(system, modes, integers) / modes.temperature
        m = int(np.argmax(swing))
        if not swing[m] <= MAX_NEGLECTED * detuning:
            relative = swing[m] / detuning if detuning else np.inf
            raise NotApplicable(
                f"internal resonance: |Σ l ω| = {detuning:.4g} for l = {_integers(integers)} "
                "is not large against the flow of energy that the damping terms excite there; "
                f"averaging would neglect a swing of {relative:.2g} of the energy of "
                f"mode {m + 1}, at most {MAX_NEGLECTED:g} is allowed"
            )


def correlations(modes: ModalAnalysis) -> Array:
    """Return for each two modes the largest correlation of Q or V = Q̇ that averaging neglects.

    With S = 2 D_ij − c_ij θ_j − c_ji θ_i, Δ = ω_i² − ω_j², w = c_ii ω_j² + c_jj ω_i² and
    N = Δ² + (c_ii + c_jj) w the cross terms of the Lyapunov equation are, to first order in S,
    E Q_i V_j = S Δ/N, E Q_i Q_j = S (c_ii + c_jj)/N and E V_i V_j = S w/N. If (8) holds, S vanishes
    and a resonance is harmless. The result (n, n) is 0 on and below the diagonal.
    """
    c, theta, omega = modes.modal_damping, modes.temperature, modes.natural_frequency
    rate = np.diag(c)
    source = np.abs(2.0 * modes.modal_noise - c * theta - (c * theta).T)
    gap = np.abs(np.subtract.outer(omega, omega)) * np.add.outer(omega, omega)
    width = np.add.outer(rate, rate)
    weight = np.outer(rate, omega**2) + np.outer(omega**2, rate)
    displacements, mixed = np.outer(omega, omega) * width, np.maximum.outer(omega, omega) * gap
    largest = np.maximum(mixed, np.maximum(displacements, weight)) / (gap**2 + width * weight)
    return np.asarray(np.triu(source / np.sqrt(np.outer(theta, theta)) * largest, 1))


def nearest_resonance(system: System, modes: ModalAnalysis) -> str:
    """Return a text: the l of smallest detuning |Σ l_i ω_i|, and the bandwidth ½ Σ |l_i| c*_ii."""
    order = resonance_order(system)
    integers, detuning = resonances(modes.natural_frequency, order, range(1, order + 1))[0]
    return (
        f"|Σ l ω| = {detuning:.4g} for l = {_integers(integers)}, against the bandwidth "
        f"{np.abs(integers) @ modes.half_bandwidth:.4g}"
    )


def _integers(integers: Integers) -> str:
    return f"({', '.join(map(str, integers))})"


def resonance_order(system: System) -> int:
    """Return the largest order Σ|l_i|, even and at least ``MIN_ORDER``, of Σ l_i ω_i to examine."""
    return max([MIN_ORDER, *(2 * ((term.factors + 1) // 2) for term in system.damping_terms)])


def resonances(
    omega: Array, order: int, sizes: Container[int], limit: float = 0.0
) -> list[tuple[Integers, float]]:
    """Return integers l and detunings |Σ l_i ω_i|, smallest detuning first, for ``omega`` ω (n,).

    These are the l with Σ|l_i| in ``sizes`` and at most ``order`` (even) whose detuning is at most
    ``limit``, or at most the smallest detuning of any l up to ``order`` if that is larger. They
    are at most ``MAX_CANDIDATES`` and may be none; l and −l count once, as the vector
    whose first nonzero entry is positive.
    """
    unit = np.eye(omega.size, dtype=np.int64)
    units = np.vstack([unit, -unit, 0 * unit[:1]])
    chosen = combinations_with_replacement(range(len(units)), order // 2)
    halves = np.unique([units[list(c)].sum(axis=0) for c in chosen], axis=0)
    frequency = halves @ omega
    ranked = np.argsort(frequency, kind="stable")
    halves, frequency = halves[ranked], frequency[ranked]
    limit = max(limit, float(np.min(np.diff(frequency))))
    vectors: set[tuple[int, ...]] = set()
    for step in range(1, frequency.size):
        close = np.flatnonzero(frequency[step:] - frequency[:-step] <= limit)
        if not close.size or len(vectors) > 10 * MAX_CANDIDATES:
            break
        for integers in halves[close + step] - halves[close]:
            if int(np.abs(integers).sum()) in sizes:
                leading = integers[np.flatnonzero(integers)[0]]
                vectors.add(tuple(int(k) for k in integers * np.sign(leading)))
    pairs = [(np.array(v), abs(float(np.dot(v, omega)))) for v in vectors]
    return sorted(pairs, key=lambda pair: pair[1])[:MAX_CANDIDATES]


def flow_amplitudes(system: System, modes: ModalAnalysis, integers: Integers) -> Array:
    """Return the amplitudes (n,) of the damping powers F_m Q̇_m that oscillate as e^{i Σ l_k φ_k}.

    ``integers`` are the l_k (n,). For Gaussian modes ``Q_k = √(2θ_k)/ω_k Re z_k``, ``Q̇_k =
    −√(2θ_k) Im z_k``, E|z_k|² = 1, the amplitude is |E[F_m Q̇_m Π z̄_k^l_k]|/√(Π |l_k|!), with z
    for z̄ if l_k < 0. With i Q̇ in the place of Q̇ all second moments are real, so that Isserlis'
    theorem applies unchanged. H in a damping term is replaced by its mean.
    """
    n, T, root = modes.n, modes.mode_shapes, np.sqrt(modes.temperature)
    zero = np.zeros((n, n))
    # Rows: displacements and velocities of the masses, velocities of the modes, the z_k.
    q, v = T * root / modes.natural_frequency, np.vstack([T, np.eye(n)]) * root
    with_waves = np.vstack([q, -v * np.sign(integers)]) * np.sqrt(0.5)
    covariance = np.block([[q @ q.T, zero, zero], [np.vstack([zero, zero]), -v @ v.T]])
    covariance = np.block([[covariance, with_waves], [with_waves.T, zero]])
    waves = tuple(int(k) for k in np.abs(integers))
    flow = np.zeros(n, dtype=complex)
    for term in system.damping_terms:
        excess = sum(waves) - term.factors
        if excess > 0 or excess % 2:
            continue
        velocities = list(term.powers("v", n))
        velocities[term.column] += 1
        level = term.coefficient * float(np.sum(modes.temperature)) ** term.energy
        # Undo the factor i of each velocity.
        unit = (1j) ** -(sum(velocities) + 1)
        for m in np.flatnonzero(T[term.row]):
            mode = tuple(int(k == m) for k in range(n))
            powers = (*term.powers("q", n), *velocities, *mode, *waves)
            flow[m] += unit * level * T[term.row, m] * gaussian_moment(covariance, powers)
    return np.asarray(np.abs(flow) / np.sqrt(prod(factorial(k) for k in waves)))
