"""Internal resonances of higher order that damping terms excite: what else averaging neglects."""

from math import factorial, prod

import numpy as np
from numpy.typing import NDArray

from averaging.modal.analysis import ModalAnalysis
from averaging.modal.resonance import MOST_CORRELATED, ORDER, integer_vectors
from fpk.damping import DampingTerm
from fpk.moments import gaussian_moment
from fpk.system import System

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

MOST_CANDIDATES = 500
"""Most resonances that are examined, those of least detuning."""
FAR = 50.0
"""Detuning, in units of the fastest rate of a mode, from which a resonance is ignored: its
swing would be below 0.1 even where what oscillates is twice as large as what averages."""


def resonance_order(system: System) -> int:
    """Return the even Σ|l_i| up to which the averages of ``system`` hold frequencies Σ l_i ω_i.

    The flow F_m Q̇_m of a term has the powers of q and v and two more factors; H is constant.
    """
    return max([ORDER, *(2 * ((_factors(term) + 1) // 2) for term in system.damping_terms)])


def _factors(term: DampingTerm) -> int:
    return term.degree - 2 * term.energy + 2


def internal_refusal(system: System, modes: ModalAnalysis) -> str | None:
    """Return which resonance of Σ|l_i| ≠ 2 forbids to average the damping terms, or None.

    The part of the energy flow into mode m that goes with the phase Σ l_i φ_i makes H_m swing by
    twice its amplitude over the detuning; relative to the energy that must be small. Resonances of
    two modes, order 2, are judged by their correlation: ``averaging.modal.resonance``.
    """
    worst, where = 0.0, (np.zeros(modes.n, dtype=np.int64), 0.0, 0)
    for integers, detuning in _candidates(system, modes):
        swing = 2.0 * np.abs(flow_amplitudes(system, modes, integers)) / modes.temperature
        m = int(np.argmax(swing))
        size = float(swing[m]) / detuning if detuning > 0.0 else np.inf * (swing[m] > 0.0)
        if size > worst:
            worst, where = float(size), (integers, detuning, m)
    if worst <= MOST_CORRELATED:
        return None
    integers, detuning, m = where
    return (
        f"internal resonance: |Σ l ω| = {detuning:.4g} for l = ({', '.join(map(str, integers))}) "
        "is not large against the flow of energy that the damping terms excite there; averaging "
        f"would neglect a swing of {worst:.2g} of the energy of mode {m + 1}, at most "
        f"{MOST_CORRELATED:g} is allowed"
    )


def flow_amplitudes(system: System, modes: ModalAnalysis, integers: Integers) -> Array:
    """Return the real amplitudes (n,) of the flows F_m Q̇_m that go with e^{i Σ l_k φ_k}.

    The modes are taken Gaussian at their balance, ``Q_k = √(2θ_k/K*_k) Re z_k`` and
    ``Q̇_k = −√(2θ_k/M*_k) Im z_k`` with E|z_k|² = 1: the amplitude is the projection
    E[F_m Q̇_m Π z̄_k^l_k]/√(Π |l_k|!), for l_k < 0 with z. With i Q̇ in the place of Q̇ all
    second moments are real and Isserlis' theorem holds as it stands; H is taken at its mean.
    """
    n, T, theta = modes.n, modes.mode_shapes, modes.temperature
    shapes = np.vstack([T, np.eye(n)])  # the velocities of the masses, then of the modes
    size = 4 * n
    covariance = np.zeros((size, size))
    covariance[:n, :n] = (T * (theta / modes.modal_stiffness)) @ T.T
    covariance[n : 3 * n, n : 3 * n] = -(shapes * (theta / modes.modal_mass)) @ shapes.T
    covariance[:n, 3 * n :] = T * np.sqrt(0.5 * theta / modes.modal_stiffness)
    covariance[n : 3 * n, 3 * n :] = (
        -shapes * np.sign(integers) * np.sqrt(0.5 * theta / modes.modal_mass)
    )
    covariance[3 * n :, : 3 * n] = covariance[: 3 * n, 3 * n :].T
    order = int(np.abs(integers).sum())
    waves = tuple(int(k) for k in np.abs(integers))
    real, imaginary = np.zeros(n), np.zeros(n)
    for term in system.damping_terms:
        if order > _factors(term) or (order - _factors(term)) % 2:
            continue
        v = list(term.powers("v", n))
        v[term.column] += 1
        level = term.coefficient * float(np.sum(theta)) ** term.energy
        # i^(number of velocities) makes a flow real or imaginary, and its sign.
        turned = (1j) ** -(sum(v) + 1)
        for m in np.flatnonzero(T[term.row]):
            mode = tuple(int(k == m) for k in range(n))
            powers = (*term.powers("q", n), *v, *mode, *waves)
            flow = turned * level * T[term.row, m] * gaussian_moment(covariance, powers)
            real[m] += flow.real
            imaginary[m] += flow.imag
    return np.asarray(np.hypot(real, imaginary) / np.sqrt(prod(factorial(k) for k in waves)))


def _candidates(system: System, modes: ModalAnalysis) -> list[tuple[Integers, float]]:
    """Resonances with a detuning so small that they may matter, least first, and their detuning."""
    if not system.damping_terms or modes.state is None or modes.n == 1:
        return []
    orders = {order for term in system.damping_terms for order in range(_factors(term), 0, -2)}
    limit = FAR * float(np.max(np.abs(modes.state.constant.diagonal())))
    limit = max(limit, FAR * float(np.max(modes.state.size(modes.temperature))))
    halves = integer_vectors(modes.n, resonance_order(system) // 2)
    frequency = halves @ modes.natural_frequency
    ranked = np.argsort(frequency, kind="stable")
    halves, frequency = halves[ranked], frequency[ranked]
    vectors: set[tuple[int, ...]] = set()
    for step in range(1, frequency.size):
        close = np.flatnonzero(frequency[step:] - frequency[:-step] < limit)
        if not close.size or len(vectors) > 10 * MOST_CANDIDATES:
            break
        for integers in halves[close + step] - halves[close]:
            size = int(np.abs(integers).sum())
            if size in orders and size != 2:
                leading = integers[np.flatnonzero(integers)[0]]
                vectors.add(tuple(int(k) for k in integers * np.sign(leading)))
    pairs = [(np.array(v), abs(float(np.dot(v, modes.natural_frequency)))) for v in vectors]
    return sorted(pairs, key=lambda pair: pair[1])[:MOST_CANDIDATES]
