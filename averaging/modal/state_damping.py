"""The averaged damping of the modes where it depends on their energies, and what it couples."""

from dataclasses import dataclass
from math import comb, factorial

import numpy as np
from numpy.typing import NDArray

from averaging.modal.phase_averages import ModeShapes, Polynomial, added, energy_flow
from fpk.errors import NotApplicable
from fpk.system import System

Array = NDArray[np.float64]

NEGLIGIBLE = 1e-12
"""A coefficient below this share of the terms that cancel in it is their round-off, so zero."""
MOST_COEFFICIENTS = 1_000_000
"""Coefficients of all averages together, 16 MB with their sizes; more are refused."""
MOST_STEPS = 4000
"""Steps of the iteration to the balance; it converges linearly, in some hundred as a rule."""
BALANCED = 1e-14
"""Imbalance of a mode, relative to all flows in and out, at which the iteration is at rest."""
FURTHEST = 1e8
"""Energies beyond this many first guesses count as growing for ever."""


@dataclass(frozen=True, eq=False)
class StateDamping:
    """Γ_mk(H) with ⟨F_m Q̇_k⟩ = Γ_mk H_k, F the modal damping force; γ_m = Γ_mm is a mode's rate.

    ``constant`` (n, n) is c*_mk/M*_k, what a constant damping matrix gives. ``parts`` add
    homogeneous polynomials, ascending in degree, one of each; coefficients (rows, n, n).
    ``sizes`` (rows, n) of each part are the sums of what cancels in γ_m.
    """

    constant: Array
    parts: tuple[Polynomial, ...]
    sizes: tuple[Array, ...]

    def rates(self, energies: Array) -> Array:
        """Return γ_m at energies (points, n), shape (points, n); the drift is −γ_m H_m + noise."""
        total = np.broadcast_to(np.diag(self.constant), energies.shape).copy()
        for part in self.parts:
            monomials = np.prod(energies[:, part.factors], axis=2)
            total += monomials @ np.einsum("rmm->rm", part.coefficients)
        return total

    def linearised(self, means: Array) -> Array:
        """Return E[F_m Q̇_k]/θ_k (n, n) for independent exponential energies of means θ (n,)."""
        total = self.constant.copy()
        for part in self.parts:
            total += np.einsum("rmk,r,rk->mk", part.coefficients, *_moments(part, means))
        return total

    def size(self, means: Array) -> Array:
        """Return the sums of the sizes of all that adds up in the mean γ_m (n,), constant apart."""
        total = np.zeros(self.constant.shape[0])
        for part, sizes in zip(self.parts, self.sizes, strict=True):
            monomials, weight = _moments(part, means)
            total += np.einsum("rm,r,rm->m", sizes, monomials, weight)
        return total

    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Return the groups of modes, ascending, within which a γ_m depends on another's energy."""
        n = self.constant.shape[0]
        joined = np.eye(n, dtype=bool)
        for part in self.parts:
            row, mode = np.nonzero(np.einsum("rmm->rm", part.coefficients))
            for factor in part.factors.T:
                joined[mode, factor[row]] = True
        # Reached in any number of steps, either way.
        reached = np.linalg.matrix_power((joined | joined.T).astype(float), n) > 0.0
        return tuple(dict.fromkeys(tuple(map(int, np.flatnonzero(row))) for row in reached))

    def of_group(self, group: tuple[int, ...]) -> "StateDamping":
        """Return the damping of a group of modes on which no other acts."""
        place = {mode: k for k, mode in enumerate(group)}
        index = np.array(group)
        chosen, sizes = [], []
        for part, size in zip(self.parts, self.sizes, strict=True):
            rows = np.flatnonzero(np.isin(part.factors, index).all(axis=1))
            factors = np.vectorize(place.get, otypes=[np.int64])(part.factors[rows])
            within = np.ix_(rows, index, index)
            chosen.append(Polynomial(factors, part.coefficients[within]))
            sizes.append(size[np.ix_(rows, index)])
        return StateDamping(self.constant[np.ix_(index, index)], tuple(chosen), tuple(sizes))

    def along(self, mode: int) -> Array:
        """Return the coefficients of γ_mode, ascending powers, where all other energies are 0."""
        degree = max((part.factors.shape[1] for part in self.parts), default=0)
        powers = np.zeros(degree + 1)
        powers[0] = self.constant[mode, mode]
        for part in self.parts:
            alone = np.all(part.factors == mode, axis=1)
            powers[part.factors.shape[1]] += part.coefficients[alone, mode, mode].sum()
        return np.asarray(np.trim_zeros(powers, "b") if powers.any() else powers[:1])


def state_damping(system: System, modes: ModeShapes, constant: Array) -> StateDamping:
    """Return the averaged damping of the modes, ``constant`` (n, n) being c*_mk/M*_k.

    Raises ``NotApplicable`` where the polynomials would have too many coefficients.
    """
    n = modes.mass.size
    half = max(term.degree for term in system.damping_terms) // 2
    if (count := comb(n + half - 1, half) * n * n) > MOST_COEFFICIENTS:
        raise NotApplicable(
            f"damping terms of degree {2 * half} and {n} modes make averages of {count} "
            f"coefficients, more than {MOST_COEFFICIENTS}"
        )
    of_degree: dict[int, list[Polynomial]] = {}
    for term in system.damping_terms:
        flow = energy_flow(modes, term)
        if flow.factors.size:
            of_degree.setdefault(flow.factors.shape[1], []).append(flow)
    parts, sizes = [], []
    for degree in sorted(of_degree):
        total = added(of_degree[degree])
        value, size = total.coefficients[..., 0], total.coefficients[..., 1]
        parts.append(
            Polynomial(total.factors, np.where(np.abs(value) > NEGLIGIBLE * size, value, 0))
        )
        sizes.append(np.einsum("rmm->rm", size))
    return StateDamping(constant, tuple(parts), tuple(sizes))


def balanced_energies(damping: StateDamping, noise: Array, guess: float) -> Array:
    """Return the θ (n,) at which independent exponential energies balance: E γ_m H_m = noise_m.

    ``noise`` is d_m/M*_m. The rates are followed downhill in ln θ from ten times ``guess``, so that
    of several balances a high one is reached. A scale for meshes and bandwidths, where damping does
    depend on the state: no answer rests on it.

    Raises ``NotApplicable`` for a mode whose energy grows for ever.
    """
    theta = np.full(noise.size, 10.0 * guess)
    for _ in range(MOST_STEPS):
        rate = np.diag(damping.linearised(theta))
        gain = noise / theta
        turnover = gain + np.abs(np.diag(damping.constant)) + damping.size(theta)
        step = (gain - rate) / turnover
        theta = theta * np.exp(0.5 * step)
        if np.any(theta > FURTHEST * guess) or np.max(np.abs(step)) < BALANCED:
            break
    worst = int(np.argmax(theta / guess + np.abs(step)))
    if np.any(theta > FURTHEST * guess) or np.max(np.abs(step)) > 1e-9:
        raise NotApplicable(
            f"mode {worst + 1}: its damping, which depends on the state, does not balance the "
            "noise, so its energy grows for ever"
        )
    return np.asarray(theta)


def _moments(part: Polynomial, means: Array) -> tuple[Array, Array]:
    """E Π H of every row (rows,), and the weights E[Π H · H_k]/(E Π H · θ_k) (rows, n)."""
    counts = (part.factors[:, :, None] == np.arange(means.size)).sum(axis=1)
    factorials = np.array([factorial(k) for k in range(1 + int(counts.max(initial=0)))], float)
    mean = np.prod(means[part.factors], axis=1) * np.prod(factorials[counts], axis=1)
    return mean, 1.0 + counts
