"""Linear scenes: the Gaussian density by the Lyapunov equation, and their motion, exact in time."""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag, eig, expm

from averaging.gaussian_state import Gaussian, state_rows
from averaging.theory import Theory, energy_only_refusal
from fpk.arrays import EPS, Array, Complexes
from fpk.certificate import Measured, certify, tolerance
from fpk.density import Density
from fpk.dynamics import Curve, Question, Rates, StationaryMotionMethod, certified_curve
from fpk.errors import NotApplicable
from fpk.linear import linear_covariance, stationary_covariance
from fpk.method import Plan, Progress, Result, silent
from fpk.observable import Coordinate, Observable
from fpk.system import System

EXPM = 160.0
"""Round-off of e^(At) in units of that of t A, and of the masses: against 50 digits, of 800 lags of
270 systems, one to three masses, up to 1e4 radians, 80 was the most."""


@dataclass(frozen=True)
class Linear(StationaryMotionMethod, Theory):
    """Gaussian density with the covariance of the Lyapunov equation, for a scene without contact.

    It is the exact stationary density of the full linear system, Eq. (6); averaging does not
    reproduce it unless (8) holds, and the difference is the averaging error. ::

        free = fpk.System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02])
        fpk.solve(free, ["q2"], methods=[Linear()])

    Of the second mass crossings of levels, spectrum and autocovariance::

        Linear().crossings(free, parse_observable("q2", 2), np.array([0.0, 0.5])).values
        Linear().spectrum(free, parse_observable("q2", 2), np.linspace(0.0, 2.0, 5)).values
        Linear().correlation(free, parse_observable("q2", 2), np.linspace(0.0, 20.0, 5)).values
        Linear().relaxation(free, 3).values
    """

    method = "linear"
    solvers = (("closed-form", "Gaussian, exact without contact", "(6)"),)
    colour = "#b86cfa"

    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` where it is not Gaussian."""
        if system.contacts:
            raise NotApplicable("the system has contacts, so its density is not Gaussian")
        modes = system.fact(linear_covariance)
        if np.max(modes.variance) <= 0.0:
            raise NotApplicable("no noise reaches a mass, so its density is concentrated at rest")

        variance = np.maximum(modes.variance, 0.0)
        # H = ½ |x|² of x = (ω Q, P).
        to_state = block_diag(modes.shapes / modes.omega, system.mass[:, None] * modes.shapes)
        gaussian = Gaussian(
            factor=to_state @ modes.axes * np.sqrt(variance),
            relative_error=modes.relative_error,
            scales=variance,
            shape=0.5,
            scale_errors=modes.variance_error,
            residual=modes.residual,
        )

        def solve(observables: Sequence[Observable], progress: Progress) -> Result:
            densities = tuple(gaussian.density(o, tol=self.wanted(system)) for o in observables)
            return Result(self, densities, settings={"equation": "Lyapunov"})

        return Plan(lambda o: energy_only_refusal(system, o) or gaussian.refusal(o), solve)

    def _crossings(self, asked: Question) -> Curve:
        """Return the upcrossings per unit time of q, by Rice's formula for a Gaussian."""
        density, q, v = self._state(asked)
        error = asked.system.fact(linear_covariance).relative_error
        values, errors = rice_rates(q, v, error, asked.at)
        scale = v / (2.0 * np.pi * q)
        return certified_curve(
            values, errors, scale=scale, of=density, tol=asked.tol or self.wanted(asked.system)
        )

    def _spectrum(self, asked: Question) -> Curve:
        """Return the power spectral density of q from the transfer functions."""
        density, q, v = self._state(asked)
        values, errors = spectral_density(asked.system, asked.row, asked.at)
        return certified_curve(
            values, errors, scale=q**3 / v, of=density, tol=asked.tol or self.wanted(asked.system)
        )

    def _correlation(self, asked: Question) -> Curve:
        """Return the autocovariance of q by the exponential of the drift matrix."""
        density, q, _ = self._state(asked)
        values, errors = autocovariance(asked.system, asked.row, asked.at)
        return certified_curve(
            values, errors, scale=q**2, of=density, tol=asked.tol or self.wanted(asked.system),
            positive=q**2 - np.abs(values),
        )  # fmt: skip

    def relaxation(
        self, system: System, count: int, *, tol: float | None = None, progress: Progress = silent
    ) -> Rates:
        """Return sums of eigenvalues of the drift matrix: those of −L are no others."""
        self.planned(system, ())
        residual = system.fact(linear_covariance).residual
        values, errors = eigenvalue_sums(system, count)
        relative = float(np.max(errors / np.abs(values)))
        certificate = certify(
            Measured(relative, None, None, residual, None), tol=tolerance(tol, self.wanted(system))
        )
        return Rates(values, errors, certificate)

    def _state(self, asked: Question) -> tuple[Density, float, float]:
        """Density of q, and the standard deviations of q and of the velocity; both not 0."""
        system, row = asked.system, asked.row
        (density,) = self.solve(system, [(Coordinate("q", row),)]).densities
        assert isinstance(density, Density)
        at = state_rows((Coordinate("q", row), Coordinate("p", row)), system.n)
        variances = np.diag(stationary_covariance(system))[at]
        if not np.min(variances) > 0.0:
            raise NotApplicable(f"no noise reaches mass {row + 1}, which is at rest")
        q, p = np.sqrt(variances)
        return density, float(q), float(p / system.mass[row])


Linear.register()


def spectral_density(system: System, row: int, at: Array) -> tuple[Array, Array]:
    """Return (1/π) [h f D fᵀ h*]_ii, h(ω) = (K − ω² M + iω c)⁻¹, of q of mass ``row``, and errors.

    White noise of E[W W'] = 2 D δ has the two-sided spectral density D/π. The error is that of a
    perturbation of all entries of h⁻¹ by their round-off.
    """
    K, M, c, D = system.stiffness_matrix, np.diag(system.mass), system.damping, system.noise_matrix
    w = at[:, None, None]
    h = np.linalg.inv(K - w**2 * M + 1j * w * c)
    rounding = 4.0 * EPS * system.n * (np.abs(K) + w**2 * M + np.abs(w * c))
    own, size = h[:, row], np.abs(h)
    changed = (size[:, row, None] @ rounding @ size)[:, 0]
    values = np.einsum("wi,ij,wj->w", own, D, own.conj()).real / np.pi
    sizes = np.einsum("wi,ij,wj->w", changed + EPS * size[:, row], np.abs(D), size[:, row])
    return values, 2.0 * sizes / np.pi


def autocovariance(system: System, row: int, at: Array) -> tuple[Array, Array]:
    """Return (e^(At) Σ)_ii of q of mass ``row`` at the lags ``at``, and errors.

    With Σ of the Lyapunov equation it solves dC/dt = A C. In (ω Q, P) of the modes, where nothing
    grows, |e^(At)| <= 1: round-off of A changes e^(At) by no more than t times itself and
    |e^(At/2)|. An error of Σ, relative to it as a quadratic form, is felt by q and its forecast.
    """
    modes = system.fact(linear_covariance)
    A = modes.drift
    w = np.append(modes.shapes[row] / modes.omega, np.zeros(system.n))
    Sigma, size = modes.covariance, float(np.linalg.norm(A, 2))
    own = float(w @ Sigma @ w)
    values, errors = np.empty(at.size), np.empty(at.size)
    for k, t in enumerate(at):
        # Of more radians than 1/EPS no digit is known, but that nothing is left.
        half = expm(0.5 * min(t, 1.0 / (EPS * size)) * A)
        forecast = w @ half @ half
        values[k] = forecast @ Sigma @ w
        rounding = EXPM * system.n * EPS * (1.0 + t * size) * float(np.linalg.norm(half, 2))
        errors[k] = rounding * float(np.linalg.norm(w) * np.linalg.norm(Sigma @ w))
        felt = np.sqrt(own * max(float(forecast @ Sigma @ forecast), 0.0))
        errors[k] += modes.relative_error * felt
    return values, errors


def rice_rates(q: float, v: float, relative: float, at: Array) -> tuple[Array, Array]:
    """Return σ_v/(2πσ_q) exp(−a²/2σ_q²) at the levels a, and errors; ``q`` and ``v`` are σ_q, σ_v.

    ``relative`` is the error of the variances.
    """
    square = (at / q) ** 2
    values = v / (2.0 * np.pi * q) * np.exp(-0.5 * square)
    return values, values * (relative + 4.0 * EPS) * (1.0 + 0.5 * square)


def eigenvalue_sums(system: System, count: int) -> tuple[Complexes, Array]:
    """Return the ``count`` eigenvalues of −L with the least positive real parts, and their errors.

    They are Σ n_j μ_j, n_j = 0, 1, …, with μ those of minus the drift matrix: the products of j
    left eigenvectors with the state are eigenfunctions of L but for terms of lower degree. One of
    a conjugate pair stands for both. The error is that of a change of the drift matrix by its
    round-off, by the condition of each eigenvalue; of one that is double it is the square root.
    """
    n = system.n
    A = system.fact(linear_covariance).drift
    decomposed: Any = eig(-A, left=True, right=True)
    mu, left, right = decomposed
    overlap = np.abs(np.sum(left.conj() * right, axis=0))
    rounding = 2 * n * EPS
    change = rounding / np.maximum(overlap, np.sqrt(rounding))
    error = float(np.linalg.norm(A, 2)) * change
    # LAPACK has conjugate pairs side by side.
    first = np.flatnonzero(mu.imag > 0.0)
    second = np.flatnonzero(mu.imag < 0.0)
    partner = np.arange(2 * n)
    partner[first], partner[second] = second, first

    def stands_for_both(terms: list[int]) -> bool:
        value = mu[list(terms)].sum()
        if abs(value.imag) > np.sqrt(EPS) * abs(value):
            return bool(value.imag > 0.0)
        return sorted(terms) <= sorted(partner[list(terms)])

    # Sums in the order of their real parts: a longer one has one more eigenvalue, none before its
    # last in this order of all.
    order = [int(j) for j in np.argsort(mu.real)]
    heap: list[tuple[float, tuple[int, ...]]] = [
        (float(mu[j].real), (place,)) for place, j in enumerate(order)
    ]
    sums: list[list[int]] = []
    while len(sums) < count:
        real, places = heapq.heappop(heap)
        terms = [order[place] for place in places]
        if stands_for_both(terms):
            sums.append(terms)
        for place in range(places[-1], 2 * n):
            heapq.heappush(heap, (real + float(mu[order[place]].real), (*places, place)))
    return np.array([mu[terms].sum() for terms in sums]), np.array([error[t].sum() for t in sums])
