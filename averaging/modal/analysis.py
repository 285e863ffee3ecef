"""Modal analysis of the chain without contacts and its averaged energies, Eqs. (12)-(18), (33).

Damping averaged over the phases is a polynomial in the modal energies, section 5.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import comb

import numpy as np
from scipy.linalg import block_diag
from scipy.special import factorial

from fpk.numeric.arrays import EPS, ROUND_OFF, Array, Integers
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.solvers.line.mesh import probe_process
from fpk.system.damping import DampingTerm, gaussian_moment
from fpk.system.ends import require_confined
from fpk.system.equivalent import equivalent_temperature
from fpk.system.linear import natural_modes
from fpk.system.process import Coefficients, Process
from fpk.system.system import System

MAX_COEFFICIENTS = 1_000_000
"""Largest number of coefficients Γ_mk of all monomials (8 MB, and as much for their sizes)."""
MAX_STEPS = 4000
"""Largest number of steps to the balanced energies; the iteration is linear, some hundred steps."""
UNBOUNDED = 1e8
"""Multiple of the first guess above which an energy is taken to grow for ever."""


@dataclass(frozen=True, eq=False)
class AveragedDamping:
    """Γ_mk(H) with ⟨F_m Q̇_k⟩ = Γ_mk(H) H_k, F the modal damping forces; γ_m = Γ_mm is a rate.

    Row r is the monomial Π_j H_factors[r, j] with the energies counted from 1 and H_0 = 1; row 0 is
    the constant. ``factors`` (rows, degree), ``values`` (rows, n, n) the coefficients, ``sizes``
    the sums of absolute values behind them.
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

    def mean(self, means: Array) -> tuple[Array, Array]:
        """Return E[F_m Q̇_k]/E H_k for independent exponential energies, and the sum of sizes."""
        # Powers of the energies in each monomial (rows, n).
        counts = (self.factors[:, :, None] == np.arange(1, means.size + 1)).sum(axis=1)
        moments = _monomials(self.factors, means) * factorial(counts).prod(axis=1)
        weights = moments[:, None] * (1.0 + counts)
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


@dataclass(frozen=True, eq=False)
class ModalAnalysis:
    """Modes of K T = M T ω², ascending, of unit modal mass, with damping and noise.

    ``X = T Q`` (14) and ``P = Tᵀ p = Q̇``. ``mode_shapes`` T (n, n), one mode a column, Tᵀ M T = 1;
    ``state_shapes`` S (2n, 2n), so that (q, p) = S (ω Q, P); ``natural_frequency`` ω (n,) in
    radians per time, K* = ω²; ``modal_noise`` D* = Tᵀ f D fᵀ T (n, n), E[W*_i W*_j'] = 2 D*_ij δ.
    ``modal_damping`` c* = Tᵀ c T (n, n), or where the damping depends on the state that of
    statistical linearisation, c*_mk = E[F_m Q̇_k]/E Q̇_k². ``averaged`` is the damping averaged over
    the phases; ``constant`` says that it does not depend on the state. ``relative_error`` estimates
    the relative round-off of damping and noise.
    """

    mode_shapes: Array
    state_shapes: Array
    natural_frequency: Array
    modal_damping: Array
    modal_noise: Array
    averaged: AveragedDamping
    constant: bool
    relative_error: float

    @property
    def n(self) -> int:
        """Number of modes."""
        return self.natural_frequency.size

    @property
    def noise(self) -> Array:
        """d_i = D*_ii of each mode (n,)."""
        return np.diag(self.modal_noise)

    @property
    def half_bandwidth(self) -> Array:
        """c*_ii/2, the rate at which the amplitude of a mode decays (n,)."""
        return np.asarray(0.5 * np.diag(self.modal_damping))

    @property
    def temperature(self) -> Array:
        """θ_i = d_i/c*_ii, the mean energy of each mode (n,); a scale only if not ``constant``."""
        return np.asarray(self.noise / np.diag(self.modal_damping))

    def process(self, modes: Sequence[int] | None = None) -> Process:
        """Return dH_i = s_i dt + σ_il dB_l of some modes on which no other acts, or of all of them.

        ``s_i = d_i − γ_i(H) H_i``, ``b_ii = 2 d_i H_i``, ``b_ij = 0``, (17), (33). Corrections:
        (33) prints s_i without noise and mass, b_ii without H_i and with D₂ for D₁ in b₂₂; (18)
        prints P_i/M_j P_j and a noise term without masses. The density of states is the period, a
        constant; at H = 0, where 2 s(0)/b' = 1, p is finite and positive.
        """
        index = list(range(self.n) if modes is None else modes)
        d, rates = self.noise[index], self.averaged.rates(index)

        def coefficients(energies: Array) -> Coefficients:
            H = energies.reshape(-1, d.size)
            b = 2.0 * d * H
            dissipation = (-rates(H) * H).reshape(energies.shape)
            zero = np.zeros_like(energies)
            drift, slope = d + dissipation, 2.0 * d + zero
            if d.size == 1:
                b = b.reshape(energies.shape)
                return Coefficients(drift, b, slope, dissipation, zero, zero)
            return Coefficients(drift, b[:, :, None] * np.eye(d.size), slope, dissipation)

        return Process(coefficients, tuple(float(theta) for theta in self.temperature[index]))


def modal_analysis(system: System) -> ModalAnalysis:
    """Return the modes of ``system`` without its contacts, Eqs. (13)-(16).

    Raises ``NotApplicable`` where a mode is not damped, or no noise reaches it, or damping that
    depends on the state lets energies grow for ever.
    """
    T, omega = natural_modes(system)
    averaged, constant = averaged_damping(system, T, omega), not system.damping_terms
    D, size = T.T @ system.noise_matrix @ T, np.abs(T.T) @ np.abs(system.noise_matrix) @ np.abs(T)
    c, noise = averaged.values[0], np.diag(D)
    names = [f"mode {i + 1} (ω = {w:.4g})" for i, w in enumerate(omega)]
    for i in np.flatnonzero(np.diag(c) <= 0.0) if constant else ():
        raise NotApplicable(f"{names[i]} is not damped, so its energy grows for ever")
    for i in np.flatnonzero(noise <= ROUND_OFF * np.diag(size)):
        raise NotApplicable(
            f"{names[i]} gets no noise, so its energy has no density: b_ii of (17) vanishes"
        )
    theta = noise / np.diag(c) if constant else balanced_energies(system, averaged, noise)
    damping, damping_size = averaged.mean(theta)
    # Round-off is relative to what cancels in the damping and in the noise of a mode.
    cancelling = np.max(np.diag(damping_size) * theta / noise) + np.max(np.diag(size) / noise)
    # Modes have that of singular values, n ε ω_max, over the least gap of ω, that to 0 included.
    gap = max(float(np.min(np.diff(omega, prepend=0.0))), EPS * float(omega[-1]))
    round_off = 2.0 * omega.size * EPS * float(omega[-1]) / gap
    modes = ModalAnalysis(
        mode_shapes=T,
        # p = T⁻ᵀ P, where (35) prints T_11^{-1} for an element of the matrix T⁻¹ = Tᵀ M.
        state_shapes=block_diag(T / omega, system.mass[:, None] * T),
        natural_frequency=omega,
        modal_damping=c if constant else damping,
        modal_noise=D,
        averaged=averaged,
        constant=constant,
        relative_error=round_off * float(cancelling),
    )
    # Energies that the damping couples grow for ever or not; of more than two that is not judged.
    for group in () if constant else averaged.groups:
        try:
            if len(group) == 1:
                probe_process(modes.process(group))
            elif len(group) == 2:
                require_confined(modes.process(group))
        except NotCertified as reason:
            grow = " and ".join(f"H{m + 1}" for m in group)
            raise NotApplicable(f"{grow}: {reason}, so the energy grows for ever") from reason
    return modes


def averaged_damping(system: System, shapes: Array, omega: Array) -> AveragedDamping:
    """Return the averages over independent uniform phases of the modes T (n, n) of ``omega`` (n,).

    Raises ``NotApplicable`` where the polynomials would have too many coefficients.
    """
    n, terms = omega.size, system.damping_terms
    degree = max((term.degree // 2 for term in terms), default=0)
    if (count := comb(n + degree, degree) * n * n) > MAX_COEFFICIENTS:
        raise NotApplicable(
            f"damping terms of degree {2 * degree} and {n} modes make averages of {count} "
            f"coefficients, more than {MAX_COEFFICIENTS}"
        )

    def total(T: Array, damping: Array, sign: Callable[[float], float]) -> tuple[Integers, Array]:
        """Rows and Γ_mk (rows, n, n): c*_mk of the constant damping, and each damping term's."""
        rows, values = [np.zeros((1, degree), dtype=np.int64)], [(T.T @ damping @ T)[None]]
        for term in terms:
            flow = _velocity_average(term, T, omega)
            modes = np.indices(flow.shape[1:]).reshape(flow.ndim - 1, flow[0].size).T + 1
            rows.append(np.pad(np.sort(modes, axis=1), ((0, 0), (degree - modes.shape[1], 0))))
            flow = sign(term.coefficient) * flow.reshape(n, -1).T
            values.append(T[term.row][:, None] * flow[:, None, :])
        factors, row = np.unique(np.concatenate(rows), axis=0, return_inverse=True)
        total = np.zeros((len(factors), n, n))
        np.add.at(total, row.ravel(), np.concatenate(values))
        return factors, total

    factors, values = total(shapes, system.damping, float)
    _, sizes = total(np.abs(shapes), np.abs(system.damping), abs)
    return AveragedDamping(factors, np.where(np.abs(values) > ROUND_OFF * sizes, values, 0), sizes)


def _velocity_average(term: DampingTerm, shapes: Array, omega: Array) -> Array:
    """⟨Π q_a^. Π v_a^. v_j H^energy Q̇_k⟩/H_k, its coefficients (k, modes of each factor H_m ..).

    With Q_m = √(2 H_m)/ω_m cos φ_m and Q̇_m = −√(2 H_m) sin φ_m, exponential energies of means θ_m
    make the modes Gaussian, and E Π H_m^α_m = Π α_m! θ_m^α_m: the phase average has the
    coefficients of the Gaussian moment, a polynomial in θ by Isserlis' theorem, divided by Π α_m!.
    """
    n = omega.size
    # Factors Q̇, q and v: velocities are correlated with velocities only, displacements likewise.
    powers = np.array([1, *term.powers("q", n), *term.powers("v", n)])
    powers[1 + n + term.column] += 1
    own = np.flatnonzero(powers)
    x, velocity = np.vstack([np.ones(n), shapes / omega, shapes])[own], (own == 0) | (own > n)
    parts = np.equal.outer(velocity, velocity)[:, :, None] * (x[:, None] * x)
    flow = np.asarray(gaussian_moment(parts, tuple(powers[own].tolist())))
    counts = (np.indices(flow.shape[1:])[..., None] == np.arange(n)).sum(axis=0)
    shares = factorial(counts).prod(axis=-1, keepdims=True) * (1.0 + counts)
    flow = flow / np.moveaxis(shares, -1, 0)
    return np.asarray(np.multiply.outer(flow, np.ones((n,) * term.energy)))


def balanced_energies(system: System, damping: AveragedDamping, noise: Array) -> Array:
    """Return the means (n,) at which independent exponential energies balance: E γ_m H_m = d_m.

    A scale for meshes and bandwidths; of several balances a high one. Raises ``NotApplicable`` for
    a mode whose energy grows for ever.
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
        if np.any(theta > UNBOUNDED * guess) or np.max(np.abs(step)) < ROUND_OFF:
            break
    worst = int(np.argmax(theta / guess + np.abs(step)))
    if np.any(theta > UNBOUNDED * guess) or np.max(np.abs(step)) > 1e-9:
        raise NotApplicable(
            f"mode {worst + 1}: its damping, which depends on the state, does not balance the "
            "noise, so its energy grows for ever"
        )
    return np.asarray(theta)
