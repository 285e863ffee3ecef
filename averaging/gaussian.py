"""Linear scenes: the Gaussian density by the Lyapunov equation, and their motion, exact in time."""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag, eig, expm

from averaging.gaussian_state import Gaussian
from averaging.theory import Theory, energy_only_refusal
from fpk.answer.density import Density
from fpk.answer.dynamics import Curve, Rates, certified_curve, certified_rates
from fpk.answer.method import Plan, Progress, Result
from fpk.answer.names import Coordinate, Observable
from fpk.answer.question import QUESTIONS, Asked, answer
from fpk.numeric.arrays import EPS
from fpk.numeric.errors import NotApplicable
from fpk.system.linear import linear_covariance, stationary_covariance
from fpk.system.system import System

EXPM = 160.0
"""Round-off of e^(At) in units of that of t A, and of the masses: against 50 digits, of 800 lags of
270 systems, one to three masses, up to 1e4 radians, 80 was the most."""


@dataclass(frozen=True)
class Linear(Theory):
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

    @answer
    def crossings(self, asked: Asked) -> Curve:
        """Return Rice's rates σ_v/(2πσ_q) exp(−a²/2σ_q²) of a Gaussian at the levels a."""
        density, q, v = self._state(asked)
        relative = asked.system.fact(linear_covariance).relative_error + 4.0 * EPS
        scale, square = QUESTIONS["crossings"].scale(q, v), (asked.at / q) ** 2
        values = scale * np.exp(-0.5 * square)
        errors = values * relative * (1.0 + 0.5 * square)
        tol = asked.tol or self.wanted(asked.system)
        return certified_curve(values, errors, scale=scale, of=density, tol=tol)

    @answer
    def spectrum(self, asked: Asked) -> Curve:
        """Return (1/π) [h f D fᵀ h*]_ii of q, h(ω) = (K − ω² M + iω c)⁻¹ the transfer functions.

        White noise of E[W W'] = 2 D δ has the two-sided spectral density D/π. The error is that of
        a perturbation of all entries of h⁻¹ by their round-off.
        """
        system, row, w = asked.system, asked.row, asked.at[:, None, None]
        density, q, v = self._state(asked)
        K, M, c = system.stiffness_matrix, np.diag(system.mass), system.damping
        h = np.linalg.inv(K - w**2 * M + 1j * w * c)
        rounding = 4.0 * EPS * system.n * (np.abs(K) + w**2 * M + np.abs(w * c))
        own, size, D = h[:, row], np.abs(h), system.noise_matrix
        changed = (size[:, row, None] @ rounding @ size)[:, 0]
        values = np.einsum("wi,ij,wj->w", own, D, own.conj()).real / np.pi
        errors = np.einsum("wi,ij,wj->w", changed + EPS * size[:, row], np.abs(D), size[:, row])
        tol = asked.tol or self.wanted(system)
        scale = QUESTIONS["spectrum"].scale(q, v)
        return certified_curve(values, 2.0 * errors / np.pi, scale=scale, of=density, tol=tol)

    @answer
    def correlation(self, asked: Asked) -> Curve:
        """Return the autocovariance (e^(At) Σ)_ii of q, with Σ of the Lyapunov equation.

        In (ω Q, P) of the modes |e^(At)| <= 1: round-off of A changes e^(At) by no more than t
        times itself and |e^(At/2)|. An error of Σ, a quadratic form, is felt by q and its forecast.
        """
        density, q, v = self._state(asked)
        modes = asked.system.fact(linear_covariance)
        A, Sigma, n = modes.drift, modes.covariance, asked.system.n
        w = np.append(modes.shapes[asked.row] / modes.omega, np.zeros(n))
        size, own = float(np.linalg.norm(A, 2)), float(w @ Sigma @ w)
        values, errors = np.empty((2, asked.at.size))
        for k, t in enumerate(asked.at):
            # Of more radians than 1/EPS no digit is known, but that nothing is left.
            half = expm(0.5 * min(t, 1.0 / (EPS * size)) * A)
            forecast = w @ half @ half
            values[k] = forecast @ Sigma @ w
            rounding = EXPM * n * EPS * (1.0 + t * size) * float(np.linalg.norm(half, 2))
            felt = np.sqrt(own * max(float(forecast @ Sigma @ forecast), 0.0))
            errors[k] = rounding * float(np.linalg.norm(w) * np.linalg.norm(Sigma @ w))
            errors[k] += modes.relative_error * felt
        scale, tol = QUESTIONS["correlation"].scale(q, v), asked.tol or self.wanted(asked.system)
        left = scale - np.abs(values)
        return certified_curve(values, errors, scale=scale, of=density, tol=tol, positive=left)

    @answer
    def relaxation(self, asked: Asked) -> Rates:
        """Return the eigenvalues Σ n_j μ_j, n_j = 0, 1, …, of −L, μ of minus the drift matrix.

        Products of left eigenvectors with the state are eigenfunctions of L but for terms of lower
        degree. One of a conjugate pair stands for both. The error is that of a change of the drift
        matrix by its round-off, by the condition of each eigenvalue, of a double one the root.
        """
        system = asked.system
        self.planned(system, ())
        covariance = system.fact(linear_covariance)
        decomposed: Any = eig(-covariance.drift, left=True, right=True)
        mu, left, right = decomposed
        first, second = np.flatnonzero(mu.imag > 0.0), np.flatnonzero(mu.imag < 0.0)
        partner = np.arange(mu.size)  # LAPACK has conjugate pairs side by side
        partner[first], partner[second] = second, first
        order = np.argsort(mu.real)
        mu, partner = mu[order], np.argsort(order)[partner[order]]
        overlap = np.abs(np.sum(left.conj() * right, axis=0))[order]
        rounding = EPS * mu.size
        change = rounding / np.maximum(overlap, np.sqrt(rounding))
        error = float(np.linalg.norm(covariance.drift, 2)) * change
        # Sums in the order of their real parts: a longer one has one more eigenvalue, none before
        # its last.
        heap: list[tuple[float, list[int]]] = [(x, [j]) for j, x in enumerate(mu.real.tolist())]
        sums: list[list[int]] = []
        while len(sums) < asked.count:
            real, terms = heapq.heappop(heap)
            value = mu[terms].sum()
            is_real = abs(value.imag) <= np.sqrt(EPS) * abs(value)
            if terms <= sorted(partner[terms]) if is_real else value.imag > 0.0:
                sums.append(terms)
            for j in range(terms[-1], mu.size):
                heapq.heappush(heap, (real + float(mu[j].real), [*terms, j]))
        values = np.array([mu[terms].sum() for terms in sums])
        errors = np.array([error[terms].sum() for terms in sums])
        tol = asked.tol or self.wanted(system)
        return certified_rates(values, errors, tol=tol, residual=covariance.residual)

    def _state(self, asked: Asked) -> tuple[Density, float, float]:
        """Density of q, and the standard deviations of q and of the velocity; both not 0."""
        system, row = asked.system, asked.row
        (density,) = self.solve(system, [(Coordinate("q", row),)]).densities
        assert isinstance(density, Density)
        variances = np.diag(stationary_covariance(system))[[row, row + system.n]]
        if not np.min(variances) > 0.0:
            raise NotApplicable(f"no noise reaches mass {row + 1}, which is at rest")
        q, p = np.sqrt(variances)
        return density, float(q), float(p / system.mass[row])


Linear.register()
