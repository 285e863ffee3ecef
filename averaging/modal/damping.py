"""Damping of the modes averaged over their phases: polynomials in the modal energies, section 5."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import product
from math import comb, factorial, prod

import numpy as np

from fpk.arrays import Array, Integers
from fpk.damping import DampingTerm
from fpk.equivalent import equivalent_temperature
from fpk.errors import NotApplicable
from fpk.system import System

Polynomial = dict[tuple[int, ...], Array]
"""Σ value · Π H_m over the modes m in each key, counted from 0, ascending, one for each power."""

NEGLIGIBLE = 1e-12
"""Share of the terms added up in a coefficient below which it is their round-off, so zero."""
MAX_COEFFICIENTS = 1_000_000
"""Largest number of coefficients Γ_mk of all monomials (8 MB, and as much for their sizes)."""
MAX_STEPS = 4000
"""Largest number of steps to the balanced energies; the iteration is linear, some hundred steps."""
BALANCED = 1e-14
"""Imbalance of a mode, relative to all power in and out, at which the iteration has converged."""
UNBOUNDED = 1e8
"""Multiple of the first guess above which an energy is taken to grow for ever."""


@dataclass(frozen=True, eq=False)
class AveragedDamping:
    """Γ_mk(H) with ⟨F_m Q̇_k⟩ = Γ_mk(H) H_k, where F are the modal damping forces.

    The damping rate of mode m is γ_m = Γ_mm. Row r is the monomial Π_j H_factors[r, j] with the
    energies counted from 1 and H_0 = 1; row 0 is the constant. ``factors`` (rows, degree),
    ``values`` (rows, n, n) the coefficients, ``sizes`` the sums of absolute values behind them.
    """

    factors: Integers
    values: Array
    sizes: Array

    def rates(self, group: Sequence[int]) -> Callable[[Array], Array]:
        """Return γ_m of the modes of ``group``, on which no other acts, of their H (points, k)."""
        index = np.array(group)
        rows = np.isin(self.factors, [0, *(index + 1)]).all(axis=1)
        column = np.zeros(self.values.shape[1] + 1, dtype=np.int64)
        column[index + 1] = np.arange(1, index.size + 1)
        factors, rate = column[self.factors[rows]], self.values[rows][:, index, index]
        return lambda energies: _monomials(factors, energies) @ rate

    def powers(self, mode: int) -> Array:
        """Return the coefficients of γ of a mode on which no other acts, ascending powers of H."""
        alone = np.isin(self.factors, [0, mode + 1]).all(axis=1)
        degree = np.count_nonzero(self.factors[alone], axis=1)
        return np.asarray(np.bincount(degree, self.values[alone, mode, mode]), dtype=float)

    def mean(self, means: Array) -> tuple[Array, Array]:
        """Return E[F_m Q̇_k]/E H_k for independent exponential energies, and the sum of sizes."""
        counts = (self.factors[:, :, None] == np.arange(1, means.size + 1)).sum(axis=1)
        highest = 1 + int(counts.max(initial=0))
        moments = np.array([factorial(k) for k in range(1 + highest)])[counts].prod(axis=1)
        weights = (_monomials(self.factors, means) * moments)[:, None] * (1.0 + counts)
        value, size = (np.einsum("rmk,rk->mk", x, weights) for x in (self.values, self.sizes))
        return value, size

    @cached_property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """The groups of modes, ascending, within which a γ_m depends on another's energy."""
        n = self.values.shape[1]
        joined = np.eye(n, n + 1, 1)
        row, mode = np.nonzero(np.einsum("rmm->rm", self.values))
        for column in self.factors.T:
            joined[mode, column[row]] = 1.0
        # Modes that are reached in any number of steps, either way.
        reached = np.linalg.matrix_power(joined[:, 1:] + joined[:, 1:].T, n) > 0.0
        return tuple(dict.fromkeys(tuple(map(int, np.flatnonzero(row))) for row in reached))


def _monomials(factors: Integers, energies: Array) -> Array:
    """Π_j H_factors[r, j] (..., rows) at energies (..., n), with H_0 = 1."""
    with_one = np.concatenate([np.ones((*energies.shape[:-1], 1)), energies], axis=-1)
    return np.asarray(with_one[..., factors].prod(axis=-1))


def averaged_damping(system: System, shapes: Array, omega: Array) -> AveragedDamping:
    """Return the averages over independent uniform phases of the modes, X = T Q (14).

    ``shapes`` T (n, n) with Tᵀ M T = 1, ``omega`` (n,). Raises ``NotApplicable`` where the
    polynomials would have too many coefficients.
    """
    n, terms = omega.size, system.damping_terms
    degree = max((term.degree // 2 for term in terms), default=0)
    if (count := comb(n + degree, degree) * n * n) > MAX_COEFFICIENTS:
        raise NotApplicable(
            f"damping terms of degree {2 * degree} and {n} modes make averages of {count} "
            f"coefficients, more than {MAX_COEFFICIENTS}"
        )

    def total(T: Array, damping: Array, sign: Callable[[float], float]) -> Polynomial:
        """Γ_mk (n, n): c*_mk of the constant damping and what each damping term adds."""
        polynomial: Polynomial = defaultdict(lambda: np.zeros((n, n)))
        polynomial[()] = T.T @ damping @ T
        for term in terms:
            for modes, value in _velocity_average(term, T, omega).items():
                polynomial[modes] += sign(term.coefficient) * np.outer(T[term.row], value)
        return polynomial

    polynomial = total(shapes, system.damping, float)
    bound = total(np.abs(shapes), np.abs(system.damping), abs)
    factors = np.zeros((len(polynomial), degree), dtype=np.int64)
    for row, modes in enumerate(polynomial):
        factors[row, : len(modes)] = np.array(modes, dtype=np.int64) + 1
    values, sizes = (np.array([p[modes] for modes in polynomial]) for p in (polynomial, bound))
    return AveragedDamping(factors, np.where(np.abs(values) > NEGLIGIBLE * sizes, values, 0), sizes)


def _velocity_average(term: DampingTerm, shapes: Array, omega: Array) -> Polynomial:
    """⟨Π q_a^. Π v_a^. v_j H^energy Q̇_k⟩/H_k as a polynomial in the energies, values (n,).

    With Q_m = √(2 H_m)/ω_m cos φ_m and Q̇_m = −√(2 H_m) sin φ_m, exponential energies of means θ_m
    make the modes Gaussian, and E Π H_m^α_m = Π α_m! θ_m^α_m: the phase average has the
    coefficients of the Gaussian moment, a polynomial in θ by Isserlis' theorem, divided by Π α_m!.
    Of the Gaussian state E[Q̇_k f(v)] = Σ_b T_bk θ_k E ∂f/∂v_b.
    """
    n = omega.size
    rms = np.vstack([shapes / omega, shapes])  # of q and v of the masses where θ_m = 1

    @cache
    def moment(factors: tuple[int, ...]) -> Polynomial:
        """E of a product of q_a (a < n) and v_a (n + a)."""
        if not factors:
            return {(): np.array(1.0)}
        first, rest = factors[0], factors[1:]
        total: Polynomial = defaultdict(float)  # type: ignore[arg-type]
        for i, other in enumerate(rest):
            if (first < n) == (other < n):
                pair: Polynomial = {(m,): rms[first, m] * rms[other, m] for m in range(n)}
                _add_product(total, moment(rest[:i] + rest[i + 1 :]), pair)
        return total

    powers = [*term.powers("q", n), *term.powers("v", n)]
    powers[n + term.column] += 1
    factors = tuple(a for a, power in enumerate(powers) for _ in range(power))
    flow: Polynomial = defaultdict(lambda: np.zeros(n))
    for i, a in enumerate(factors):
        if a >= n:
            _add_product(flow, moment(factors[:i] + factors[i + 1 :]), {(): shapes[a - n]})
    for modes in flow:
        counts = np.bincount(np.array(modes, dtype=np.int64), minlength=n)
        flow[modes] = flow[modes] / (prod(factorial(c) for c in counts) * (1.0 + counts))
    for _ in range(term.energy):
        higher: Polynomial = defaultdict(lambda: np.zeros(n))
        _add_product(higher, flow, {(m,): np.array(1.0) for m in range(n)})
        flow = higher
    return flow


def _add_product(total: Polynomial, first: Polynomial, second: Polynomial) -> None:
    for (f, x), (g, y) in product(first.items(), second.items()):
        modes = tuple(sorted(f + g))
        total[modes] = total[modes] + x * y


def balanced_energies(system: System, damping: AveragedDamping, noise: Array) -> Array:
    """Return the means (n,) at which independent exponential energies balance: E γ_m H_m = d_m.

    The iteration starts from ten times the equivalent temperature, so that of several balances a
    high one is reached. A scale for meshes and bandwidths: no answer rests on it.

    Raises ``NotApplicable`` for a mode whose energy grows for ever.
    """
    try:
        guess = equivalent_temperature(system)
    except NotApplicable:
        guess = float(np.max(noise / np.diag(damping.sizes[0])))
    theta = np.full(noise.size, 10.0 * guess)
    for _ in range(MAX_STEPS):
        rate, size = (np.diag(x) for x in damping.mean(theta))
        step = (noise / theta - rate) / (noise / theta + size)
        theta = theta * np.exp(0.5 * step)
        if np.any(theta > UNBOUNDED * guess) or np.max(np.abs(step)) < BALANCED:
            break
    worst = int(np.argmax(theta / guess + np.abs(step)))
    if np.any(theta > UNBOUNDED * guess) or np.max(np.abs(step)) > 1e-9:
        raise NotApplicable(
            f"mode {worst + 1}: its damping, which depends on the state, does not balance the "
            "noise, so its energy grows for ever"
        )
    return np.asarray(theta)
