"""Modal analysis of the chain without contacts and its averaged energies, Eqs. (12)-(18), (33).

Damping averaged over the phases of the modes is a polynomial in the modal energies, section 5.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import comb

import numpy as np
from scipy.linalg import block_diag
from scipy.special import factorial

from fpk.numeric.arrays import BLOCK_SIZE, EPS, ROUND_OFF, Array, Integers
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.solvers.line.mesh import probe_process
from fpk.system.damping import DampingTerm, gaussian_moment
from fpk.system.ends import require_confined
from fpk.system.equivalent import equivalent_temperature
from fpk.system.linear import natural_modes
from fpk.system.process import Coefficients, Process
from fpk.system.system import System

BALANCE_STEPS = 4000
"""Largest number of iterations to energies at which damping and noise balance; usual are some
hundred, as the convergence is linear."""


@dataclass(frozen=True, eq=False)
class AveragedDamping:
    """Γ_mk(H) with ⟨F_m Q̇_k⟩ = Γ_mk(H) H_k, F_m = Σ_k c*_mk Q̇_k; γ_m = Γ_mm > 0 takes energy out.

    Γ_mk is a polynomial in the modal energies. Row r of ``factors`` (rows, degree) stands for the
    monomial Π_j H_factors[r, j], energies counted from 1 and H_0 = 1; row 0 is the constant.
    ``values`` (rows, n, n) are the coefficients, ``sizes`` the sums of the absolute values of the
    terms of each coefficient.
    """

    factors: Integers
    values: Array
    sizes: Array

    def rates(self, group: Sequence[int]) -> Callable[[Array], Array]:
        """Return the function from energies (points, k) of the k modes ``group`` to their γ_m.

        Its values are (points, k). Monomials with the energy of a mode (0-based) outside ``group``
        are omitted without a message.
        """
        index = np.array(group)
        rows = np.isin(self.factors, [0, *(index + 1)]).all(axis=1)
        column = np.zeros(self.values.shape[1] + 1, dtype=np.int64)
        column[index + 1] = np.arange(1, index.size + 1)
        factors, rate = column[self.factors[rows]], self.values[rows][:, index, index]
        return lambda energies: _energy_monomials(factors, energies) @ rate

    def mean(self, means: Array) -> tuple[Array, Array]:
        """Return E[F_m Q̇_k]/E H_k, row m and column k (n, n), and the same of ``sizes``.

        Energies are independent and exponential with the ``means`` (n,).
        """
        # Powers of each energy in each monomial (rows, n).
        counts = (self.factors[:, :, None] == np.arange(1, means.size + 1)).sum(axis=1)
        moments = _energy_monomials(self.factors, means) * factorial(counts).prod(axis=1)
        weights = moments[:, None] * (1.0 + counts)
        value, size = (np.einsum("rmk,rk->mk", x, weights) for x in (self.values, self.sizes))
        return value, size

    @cached_property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Ascending groups of all modes (0-based): γ_m depends on energies of its group only."""
        n = self.values.shape[1]
        joined = np.eye(n, n + 1, 1)
        row, mode = np.nonzero(np.einsum("rmm->rm", self.values))
        for column in self.factors.T:
            joined[mode, column[row]] = 1.0
        # Modes connected by any number of couplings, in either direction.
        connected = np.linalg.matrix_power(joined[:, 1:] + joined[:, 1:].T, n) > 0.0
        return tuple(dict.fromkeys(tuple(map(int, np.flatnonzero(row))) for row in connected))


def _energy_monomials(factors: Integers, energies: Array) -> Array:
    """Return Π_j H_factors[r, j] (..., rows) of ``factors`` at ``energies`` (..., n), H_0 = 1."""
    with_one = np.concatenate([np.ones((*energies.shape[:-1], 1)), energies], axis=-1)
    return np.asarray(with_one[..., factors].prod(axis=-1))


@dataclass(frozen=True, eq=False)
class ModalAnalysis:
    """Modes of K T = M T ω² with unit modal mass, frequencies ascending, their damping and noise.

    ``X = T Q`` (14) and ``P = Tᵀ p = Q̇``. ``mode_shapes`` T (n, n) has a mode in each column, with
    Tᵀ M T = 1; ``state_shapes`` S (2n, 2n) gives (q, p) = S (ω Q, P); ``natural_frequency`` ω (n,)
    in radians per time, K* = ω²; ``modal_noise`` D* = Tᵀ f D fᵀ T (n, n), E[W*_i W*_j'] = 2 D*_ij
    δ. ``modal_damping`` (n, n) is c* = Tᵀ c T, or if the damping depends on the state its
    statistical linearisation c*_mk = E[F_m Q̇_k]/E Q̇_k². ``averaged`` is the damping averaged over
    the phases; ``constant`` says that the damping does not depend on the state. ``relative_error``
    estimates the relative round-off of damping and noise.
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
        """θ_i = d_i/c*_ii (n,), each mode's mean energy, or its scale if not ``constant``."""
        return np.asarray(self.noise / np.diag(self.modal_damping))

    def process(self, modes: Sequence[int] | None = None) -> Process:
        """Return the process dH_i = s_i dt + σ_il dB_l of the energies of ``modes``, None: of all.

        The damping of ``modes`` (0-based) must not depend on the energies of other modes; see
        ``AveragedDamping.rates``.
        ``s_i = d_i − γ_i(H) H_i``, ``b_ii = 2 d_i H_i``, ``b_ij = 0``, (17), (33). Corrections:
        (33) prints s_i without noise and mass, b_ii without H_i and b₂₂ with D₂ for D₁; (18)
        prints P_i/M_j P_j and a noise term without masses. The density of states is the period, a
        constant; as 2 s(0)/b'(0) = 1, p is finite and positive at H = 0.
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

    Raises ``NotApplicable`` if a mode is not damped or receives no noise, if damping that depends
    on the state lets energies grow for ever, and as ``damping_averages``.
    """
    T, omega = natural_modes(system)
    averaged, constant = damping_averages(system, T, omega), not system.damping_terms
    D, size = T.T @ system.noise_matrix @ T, np.abs(T.T) @ np.abs(system.noise_matrix) @ np.abs(T)
    c, noise = averaged.values[0], np.diag(D)
    names = [f"mode {i + 1} (ω = {w:.4g})" for i, w in enumerate(omega)]
    for i in np.flatnonzero(np.diag(c) <= 0.0) if constant else ():
        raise NotApplicable(f"{names[i]} is not damped, so its energy grows for ever")
    for i in np.flatnonzero(noise <= ROUND_OFF * np.diag(size)):
        raise NotApplicable(
            f"{names[i]} gets no noise, so its energy has no density: b_ii of (17) vanishes"
        )
    theta = noise / np.diag(c) if constant else energy_balance(system, averaged, noise)
    damping, damping_size = averaged.mean(theta)
    # Largest ratio of the terms that cancel in the damping and the noise of a mode to their sum.
    cancelling = np.max(np.diag(damping_size) * theta / noise) + np.max(np.diag(size) / noise)
    # Round-off of modes: n ε ω_max, as of singular values, over the smallest gap of ω, 0 included.
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
    # Check that energies stay bounded; groups of more than two coupled modes are not checked.
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


def damping_averages(system: System, shapes: Array, omega: Array) -> AveragedDamping:
    """Return the damping of ``system`` averaged over independent uniform phases of its modes.

    The modes are ``shapes`` T (n, n), of frequencies ``omega`` (n,). Raises ``NotApplicable`` if
    the polynomials had more than ``BLOCK_SIZE`` coefficients.
    """
    n, terms = omega.size, system.damping_terms
    degree = max((term.degree // 2 for term in terms), default=0)
    if (count := comb(n + degree, degree) * n * n) > BLOCK_SIZE:
        raise NotApplicable(
            f"damping terms of degree {2 * degree} and {n} modes make averages of {count} "
            f"coefficients, more than {BLOCK_SIZE}"
        )

    def total(T: Array, damping: Array, sign: Callable[[float], float]) -> tuple[Integers, Array]:
        """Return monomials and Γ_mk (rows, n, n) for shapes ``T`` and constant ``damping``.

        ``sign`` is applied to the coefficient of each damping term.
        """
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
    """Return the coefficients of ⟨Π q_a^. Π v_a^. v_j H^energy Q̇_k⟩/H_k of ``term``, its factor 1.

    The array has the axes k, then one axis of modes for each factor H_m; ``shapes`` T (n, n) and
    ``omega`` (n,) are the modes. Exponential energies of means θ_m make the modes Gaussian, and E Π
    H_m^α_m = Π α_m! θ_m^α_m: the phase average has the coefficients of the Gaussian moment, a
    polynomial in θ by Isserlis' theorem, divided by Π α_m!.
    """
    n = omega.size
    # Factors Q̇, q and v: displacements are correlated with displacements only, and so velocities.
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


def energy_balance(system: System, damping: AveragedDamping, noise: Array) -> Array:
    """Return means (n,) of independent exponential energies with E γ_m H_m = d_m, ``noise`` d (n,).

    They are scales for meshes and bandwidths; of several solutions high energies are returned.
    Raises ``NotApplicable`` if there is none, the energy of a mode growing for ever.
    """
    try:
        guess = equivalent_temperature(system)
    except NotApplicable:
        guess = float(np.max(noise / np.diag(damping.sizes[0])))
    theta, unbounded = np.full(noise.size, 10.0 * guess), guess / EPS**0.5
    for _ in range(BALANCE_STEPS):
        rate, size = (np.diag(x) for x in damping.mean(theta))
        step = (noise / theta - rate) / (noise / theta + size)
        theta = theta * np.exp(0.5 * step)
        if np.any(theta > unbounded) or np.max(np.abs(step)) < ROUND_OFF:
            break
    worst = int(np.argmax(theta / guess + np.abs(step)))
    if np.any(theta > unbounded) or np.max(np.abs(step)) > 1e-9:
        raise NotApplicable(
            f"mode {worst + 1}: its damping, which depends on the state, does not balance the "
            "noise, so its energy grows for ever"
        )
    return np.asarray(theta)
