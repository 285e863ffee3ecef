"""Gaussian states, and the linear system: density by the Lyapunov equation, motion in time.

The energy of a Gaussian state is a weighted sum of independent gamma variables.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import erfc
from typing import Any

import numpy as np
from scipy.linalg import block_diag, eig, expm, qr, solve_triangular

from averaging.theory import Theory, energy_only_refusal
from fpk.answer.certificate import Measured
from fpk.answer.density import Density, certify_density
from fpk.answer.dynamics import (
    Curve,
    Rates,
    Transient,
    certify_curve,
    certify_rates,
    require_times,
    transient_of,
)
from fpk.answer.method import Plan, Progress, Result
from fpk.answer.names import Coordinate, Observable, observable_name
from fpk.answer.question import QUESTIONS, Asked, answer
from fpk.numeric.arrays import DEPTH, EPS, SMALLEST, Array
from fpk.numeric.errors import NotApplicable
from fpk.system.linear import (
    diffusion_matrix,
    drift_matrix,
    flow_covariance,
    linear_covariance,
    stationary_covariance,
)
from fpk.system.modulation import require_constant_noise
from fpk.system.system import System

EXPM_ROUND_OFF = 160.0
"""Stated round-off of e^(At) over ε n (1 + t‖A‖)‖e^(At/2)‖, n masses: twice the largest ratio to
the true error, from computations with 50 digits, of 800 lags of 270 systems of one to three
masses."""
FLOW_ROUND_OFF = 350.0
"""Stated relative round-off of mean and covariance in time over ε n (1 + t‖A‖): twice the largest
ratio to the true error, from computations with 60 digits, of 120 random systems of one to three
masses at times of 0.01 to 30; it is reached at early times."""
GAUSSIAN_REACH = (2.0 * DEPTH) ** 0.5
"""Half-width of the support of a Gaussian density in standard deviations: there the density is
e^−``DEPTH`` of its maximum."""
PANEL_WIDTH = 3.0
"""Largest width of a panel in standard deviations of one coordinate given the other."""
GAUSSIAN_PANELS = (17, 120)
"""Smallest and largest number of panels along an axis; correlations above 0.999 would need more."""
CONTOUR_NODES = (30, 40)
"""Nodes on half of the contour, of the comparison sum and of the answer: 32 reach round-off."""
MIN_CROSSING = 2.0
"""Smallest product of x and the point at which the contour crosses the real axis: nearer to the
singularity the sum needs more nodes, farther from it large terms cancel."""
SADDLE_STEPS = 12
"""Fixed-point steps to the saddle point; every iterate may serve as the crossing point."""


@dataclass(frozen=True, eq=False)
class Gaussian:
    """Gaussian state (q, p) = F ξ, ξ independent standard normal, whose energy is Σ λ_j G_j.

    ``factor`` is F (2n, k), F Fᵀ the covariance; ``relative_error`` bounds the relative error of
    the variance xᵀ F Fᵀ x of any x. ``scales`` λ (k,) and ``scale_errors`` (k,) are energies, G_j
    has the gamma distribution of ``shape`` and scale 1 (``gamma_sum``). ``residual`` is the
    relative residual of the equation that the state solves, None if it solves none.
    """

    factor: Array
    relative_error: float
    scales: Array
    shape: float
    scale_errors: Array
    residual: float | None

    def refusal(self, observable: Observable) -> str | None:
        """Return in words that one of two coordinates is a multiple of the other, else None."""
        if len(observable) < 2:
            return None
        rows, _, L = self._standardised(observable)
        if np.min(np.abs(np.diag(L))) > 8.0 * EPS * rows.shape[1]:
            return None
        name = observable_name(observable)
        return f"{name}: one is a multiple of the other at all times: there is no joint density"

    def _standardised(self, observable: Observable) -> tuple[Array, Array, Array]:
        """Return rows of F (axes, k), standard deviations σ (axes,) and L (axes, axes).

        The observed coordinates are x_i = σ_i (L y)_i, L lower triangular, cov y = 1.
        """
        rows = self.factor[state_rows(observable, self.factor.shape[0] // 2)]
        scale = np.linalg.norm(rows, axis=1)
        L = qr((rows / scale[:, None]).T, mode="r")[0][: len(observable)].T
        return rows, scale, np.asarray(L)

    def density(self, observable: Observable, *, tol: float) -> Density:
        """Return the density of H, or of one or two of (q, p), with its certificate.

        ``tol`` is the L1 tolerance. Raises ``NotApplicable`` with the reason of ``refusal``.
        """
        if observable[0].kind == "H":
            return self._energy_density(observable, tol)
        if reason := self.refusal(observable):
            raise NotApplicable(reason)
        count = len(observable)
        rows, scale, L = self._standardised(observable)
        # The round-off of the rows is multiplied by the condition number of L.
        relative = self.relative_error + 8.0 * EPS * rows.shape[1] * float(np.linalg.cond(L))
        height = (2.0 * np.pi) ** (-0.5 * count) / abs(float(np.prod(np.diag(L)) * np.prod(scale)))
        width = PANEL_WIDTH * float(np.min(np.abs(np.diag(L))))
        panels = int(np.clip(np.ceil(2.0 * GAUSSIAN_REACH / width), *GAUSSIAN_PANELS))

        def half_square(x: Sequence[Array]) -> Array:
            z = np.stack(np.broadcast_arrays(*x))
            y = solve_triangular(L, z.reshape(count, -1) / scale[:, None], lower=True)
            return np.asarray(0.5 * np.sum(y * y, axis=0).reshape(z.shape[1:]))

        def pointwise(*x: Array) -> Array:
            # d ln p = ½ yᵀ E y − ½ tr E, where E = L⁻¹ dR L⁻ᵀ is at most ``relative`` in norm.
            exponent = half_square(x)
            return np.asarray(relative * (exponent + 0.5 * count) * height * np.exp(-exponent))

        tail = count * erfc(GAUSSIAN_REACH * 0.5**0.5)
        return certify_density(
            observable,
            tuple(np.linspace(-GAUSSIAN_REACH * s, GAUSSIAN_REACH * s, panels + 1) for s in scale),
            lambda *x: height * np.exp(-half_square(x)),
            pointwise,
            measured=Measured(count * relative + tail, np.nan, np.inf, self.residual, tail),
            tol=tol,
            # The mass is integrated in y, x = scale L y: in x a correlation makes a ridge.
            frame=(
                scale[:, None] * L,
                (np.linspace(-GAUSSIAN_REACH, GAUSSIAN_REACH, GAUSSIAN_PANELS[0] + 1),) * count,
            ),
        )

    def _energy_density(self, observable: Observable, tol: float) -> Density:
        largest, tail = float(np.max(self.scales)), float(np.exp(-DEPTH))
        # Chernoff's bound with s = 7/8 of 1/max λ: P(X > E) <= e^(−sE) Π (1 − s λ_j)^−shape.
        s = 0.875 / largest
        end = (DEPTH - self.shape * float(np.sum(np.log1p(-s * self.scales)))) / s
        nodes, least = [0.0], max(float(np.min(self.scales)), EPS * end)
        while nodes[-1] < end:
            nodes.append(nodes[-1] + min(max(2.0 * least, nodes[-1] / 3.0), 2.0 * largest))

        def error(energy: Array) -> Array:
            return gamma_sum(self.scales, self.shape, self.scale_errors, energy)[1]

        return certify_density(
            observable,
            (np.array([*nodes[:-1], end]),),
            # Without the error, whose evaluation takes twice as long as that of the density.
            lambda energy: _contour(self.scales, self.shape, energy, CONTOUR_NODES[1])[0].real.sum(
                -1
            ),
            error,
            measured=Measured(tail, np.nan, np.inf, self.residual, tail),
            tol=tol,
            added_error=lambda p, energy: error(energy),
        )


def state_rows(observable: Observable, n: int) -> list[int]:
    """Return the indices of the coordinates of ``observable`` in (q, p) (2n,) of ``n`` masses."""
    return [c.row + (n if c.kind == "p" else 0) for c in observable]


def gamma_sum(scales: Array, shape: float, errors: Array, x: Array) -> tuple[Array, Array]:
    """Return the density of Σ λ_j G_j at ``x`` of any shape, and its estimated absolute error.

    G_j are independent gamma variables of the given ``shape`` and scale 1, λ_j >= 0 the ``scales``
    (k,), whose errors are ``errors`` (k,). The density is the inverse Laplace transform of
    Π (1 + λ_j s)^−shape: with z = 1 + λ_max s the trapezoidal rule on the parabola z = c (1 + iu)²,
    c at the saddle point or to its right, converges geometrically and with relative accuracy for
    any ratios of the scales (Weideman and Trefethen, Math. Comp. 76 (2007) 1341).

    The error is the sum of the difference to a coarser contour, the round-off of the terms, and the
    effect of ``errors`` by ∂ ln p^/∂λ_j = −shape s/(1 + λ_j s), p^ the Laplace transform.
    """
    terms, exponent, z = _contour(scales, shape, x, CONTOUR_NODES[1])
    density: Array = terms.real.sum(axis=-1)
    error = np.abs(density - _contour(scales, shape, x, CONTOUR_NODES[0])[0].real.sum(axis=-1))
    largest = np.max(scales)
    for r, of_scale in zip(scales / largest, errors, strict=True):
        slope = np.sum(terms * (z - 1.0) / (1.0 - r + r * z), axis=-1).real
        error += np.abs(slope) * (shape / largest * of_scale)
    error += EPS * np.sum(np.abs(terms) * (4.0 + np.abs(exponent)), axis=-1)
    return density, error


def _contour(scales: Array, shape: float, x: Array, nodes: int) -> tuple[Array, Array, Array]:
    """Return the terms of the sum of ``gamma_sum`` on ``nodes`` nodes, their exponents, and z.

    All three are (*shape of ``x``, nodes). The density is the sum of the real parts of the terms;
    ``scales`` (k,) and ``shape`` are as there. For x < 0 the terms are 0, for x = 0 their values at
    a tiny x > 0.
    """
    largest = float(np.max(scales))
    t = np.maximum(x / largest, SMALLEST**0.5)[..., None]
    ratio = scales / largest
    crossing = scales.size * shape / t
    for _ in range(SADDLE_STEPS):
        pull = ratio / (1.0 - ratio + ratio * crossing)
        crossing = np.maximum(shape * crossing * pull.sum(axis=-1, keepdims=True), MIN_CROSSING) / t
    step = np.sqrt(DEPTH / (crossing * t)) / nodes
    u = 1j * step * (np.arange(nodes) + 0.5)
    z = crossing * (1.0 + u) ** 2
    exponent = t * (z - 1.0)
    for r in ratio:
        factor = 1.0 - r + r * z  # np.log of a complex array takes three times as long
        exponent -= shape * (np.log(np.abs(factor)) + 1j * np.angle(factor))
    length = np.where(x[..., None] >= 0.0, 2.0 * crossing * step / (np.pi * largest), 0.0)
    return np.exp(exponent) * (1.0 + u) * length, exponent, z


@dataclass(frozen=True)
class Linear(Theory):
    """Gaussian density with the covariance of the Lyapunov equation, for a system without contact.

    It is the exact stationary density of the full linear system, Eq. (6). The averaged equations
    have the same density only if (8) holds; the difference is the averaging error. ::

        free = fpk.System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02])
        fpk.solve(free, ["q2"], methods=[Linear()])

    Crossings of levels, spectrum and autocovariance of the second mass, its density in time from
    rest, and relaxation rates::

        Linear().crossings(free, parse_observable("q2", 2), np.array([0.0, 0.5])).values
        Linear().spectrum(free, parse_observable("q2", 2), np.linspace(0.0, 2.0, 5)).values
        Linear().correlation(free, parse_observable("q2", 2), np.linspace(0.0, 20.0, 5)).values
        times, at = np.array([1.0, 10.0]), (np.array([0.0, 0.5]),)
        Linear().transient(free, parse_observable("q2", 2), REST, times, at).values
        Linear().relaxation(free, 3).values
    """

    method = "linear"
    solvers = (("closed-form", "Gaussian, exact without contact", "(6)"),)
    colour = "#b86cfa"

    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``.

        Raises ``NotApplicable`` if it has contacts, damping terms, an undamped mode or no noise.
        """
        if system.contacts:
            raise NotApplicable("the system has contacts, so its density is not Gaussian")
        modes = system.fact(linear_covariance)
        if np.max(modes.variance) <= 0.0:
            raise NotApplicable("no noise reaches a mass, so its density is concentrated at rest")

        # A variance below its error is 0: its round-off would pass for independent motion.
        variance = np.where(modes.variance > modes.variance_error, modes.variance, 0.0)
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
            densities = tuple(gaussian.density(o, tol=self.tol_for(system)) for o in observables)
            return Result(self, densities, settings={"equation": "Lyapunov"})

        return Plan(lambda o: energy_only_refusal(system, o) or gaussian.refusal(o), solve)

    @answer
    def crossings(self, asked: Asked) -> Curve:
        """Return the upcrossing rates σ_v/(2πσ_q) exp(−a²/2σ_q²) of the levels a (Rice)."""
        scale, std, certified = self._curve(asked, "crossings")
        relative = asked.system.fact(linear_covariance).relative_error + 4.0 * EPS
        square = (asked.at / std) ** 2
        values = scale * np.exp(-0.5 * square)
        return certified(values, values * relative * (1.0 + 0.5 * square))

    @answer
    def spectrum(self, asked: Asked) -> Curve:
        """Return the spectral density (1/π) [h f D fᵀ h*]_ii of q_i at the angular frequencies ω.

        h(ω) = (K − ω² M + iω c)⁻¹ is the matrix of transfer functions. The spectral density is
        two-sided: white noise with E[W W'] = 2 D δ has D/π.
        """
        system, row, w = asked.system, asked.row, asked.at[:, None, None]
        _, _, certified = self._curve(asked, "spectrum")
        K, M, c = system.stiffness_matrix, np.diag(system.mass), system.damping
        h = np.linalg.inv(K - w**2 * M + 1j * w * c)
        rounding = 4.0 * EPS * system.n * (np.abs(K) + w**2 * M + np.abs(w * c))
        own, size, D = h[:, row], np.abs(h), system.noise_matrix
        changed = (size[:, row, None] @ rounding @ size)[:, 0]
        values = np.einsum("wi,ij,wj->w", own, D, own.conj()).real / np.pi
        errors = np.einsum("wi,ij,wj->w", changed + EPS * size[:, row], np.abs(D), size[:, row])
        return certified(values, 2.0 * errors / np.pi)

    @answer
    def correlation(self, asked: Asked) -> Curve:
        """Return the autocovariance (e^(At) Σ)_ii of q_i at the lags t, Σ the covariance.

        A is the drift matrix in the modal coordinates (ω Q, P). There ‖e^(At)‖ <= 1, so that a
        perturbation dA changes e^(At) by at most t ‖dA‖ ‖e^(At/2)‖.
        """
        scale, _, certified = self._curve(asked, "correlation")
        modes = asked.system.fact(linear_covariance)
        A, Sigma, n = modes.drift, modes.covariance, asked.system.n
        w = np.append(modes.shapes[asked.row] / modes.omega, np.zeros(n))
        size, own = float(np.linalg.norm(A, 2)), float(w @ Sigma @ w)
        values, errors = np.empty((2, asked.at.size))
        for k, t in enumerate(asked.at):
            # After 1/EPS radians no digit is known; the values are 0 within their errors.
            half = expm(0.5 * min(t, 1.0 / (EPS * size)) * A)
            forecast = w @ half @ half
            values[k] = forecast @ Sigma @ w
            rounding = EXPM_ROUND_OFF * n * EPS * (1.0 + t * size) * float(np.linalg.norm(half, 2))
            deviations = np.sqrt(own * max(float(forecast @ Sigma @ forecast), 0.0))
            errors[k] = rounding * float(np.linalg.norm(w) * np.linalg.norm(Sigma @ w))
            errors[k] += modes.relative_error * deviations
        return certified(values, errors, positive=scale - np.abs(values))

    @answer
    def transient(self, asked: Asked) -> Transient:
        """Return the densities of one or two of (q, p), Gaussian at all times, from a given state.

        The mean is e^(At) x₀, the covariance ∫ e^(As) b e^(Aᵀs) ds over 0..t; a stationary start
        under another noise adds e^(At) Σ₀ e^(Aᵀt). A is the drift matrix of (q, p).
        """
        system, start, tol = asked.system, asked.start, asked.tol or self.tol_for(asked.system)
        require_constant_noise(system.modulation)
        if system.contacts or system.damping_terms:
            raise NotApplicable("with contacts or damping terms the density is not Gaussian")
        if start.kind in ("energy", "modal") and not start.rest:
            raise NotApplicable("from a given energy the density is not Gaussian; start at a state")
        if any(c.kind == "H" for c in asked.observable):
            raise NotApplicable("in time the densities of q and p are given, not those of energies")
        A, b, n = drift_matrix(system), diffusion_matrix(system), system.n
        rows, mean, initial = state_rows(asked.observable, n), np.zeros(2 * n), 0.0 * A
        if start.kind == "noise":
            initial = start.values["noise"] * stationary_covariance(system)
        elif not start.rest:
            mean = np.concatenate(start.state(n))
        densities, at = list[Density](), []
        for t in require_times(asked.times, positive=True).tolist():
            flow, covariance = flow_covariance(A, b, t)
            covariance = covariance + flow @ initial @ flow.T
            scale = np.sqrt(np.diag(covariance))
            if not np.all(scale[rows] > 0.0):
                raise NotApplicable("no noise reaches a coordinate, whose density is a point")
            unit = np.where(scale > 0.0, scale, 1.0)
            variance, axes = np.linalg.eigh(covariance / np.outer(unit, unit))
            factor = scale[:, None] * axes * np.sqrt(np.maximum(variance, 0.0))
            rounding = FLOW_ROUND_OFF * EPS * n * (1.0 + t * float(np.linalg.norm(A, 2)))
            gaussian = Gaussian(factor, rounding, np.ones(1), 0.5, np.zeros(1), None)
            density = gaussian.density(asked.observable, tol=tol)
            x = [np.asarray(a) - (flow @ mean)[row] for a, row in zip(asked.at, rows, strict=True)]
            densities.append(density)
            values, errors = density.at(*x)
            # A shift of the mean by δ changes p by Σ⁻¹ (x − mean) δ of itself.
            own = covariance[np.ix_(rows, rows)]
            shift = rounding * (np.abs(flow) @ np.abs(mean))[rows]
            slope = np.abs(np.linalg.solve(own, np.stack(x)))
            at.append((values, errors + values * (shift @ slope)))
        return transient_of(asked.times, densities, at, tol=tol, settings={"equation": "(6)"})

    @answer
    def relaxation(self, asked: Asked) -> Rates:
        """Return the ``asked.count`` slowest eigenvalues Σ n_j μ_j of −L, n_j = 0, 1, … not all 0.

        μ_j are the eigenvalues of minus the drift matrix: products of linear eigenfunctions are
        eigenfunctions of L up to terms of lower degree. Real parts ascend. A conjugate pair
        counts once, with Im >= 0.
        """
        system = asked.system
        self.planned(system, ())
        covariance = system.fact(linear_covariance)
        decomposed: Any = eig(-covariance.drift, left=True, right=True)
        mu, left, right = decomposed
        overlap, rounding = np.abs(np.sum(left.conj() * right, axis=0)), EPS * mu.size
        change = rounding / np.maximum(overlap, np.sqrt(rounding))
        each = np.stack([mu, float(np.linalg.norm(covariance.drift, 2)) * change], axis=1)
        # Sums and their errors; far more than asked for, as conjugates have equal real parts.
        sums, most = np.zeros((1, 2), dtype=complex), 4 * (asked.count + mu.size)
        for own in each:
            multiples = np.multiply.outer(np.arange(asked.count + 1.0), own)
            sums = (sums[:, None] + multiples).reshape(-1, 2)
            sums = sums[np.argsort(sums[:, 0].real, kind="stable")][:most]
        is_real = np.abs(sums[:, 0].imag) <= np.sqrt(EPS) * np.abs(sums[:, 0])
        upper = sums[is_real | (sums[:, 0].imag > 0.0)][1 : asked.count + 1]  # without 0
        values, errors = upper[:, 0], upper[:, 1].real
        tol = asked.tol or self.tol_for(system)
        return certify_rates(values, errors, tol=tol, residual=covariance.residual)

    def _curve(self, asked: Asked, question: str) -> tuple[float, float, Callable[..., Curve]]:
        """Return the scale of errors, the standard deviation of q, and a function (values, errors).

        The function returns the certified ``Curve``; the scale is the natural size of the values of
        ``question``, a name in ``QUESTIONS``. Raises ``NotApplicable`` if the mass is at rest.
        """
        system, row = asked.system, asked.row
        (density,) = self.solve(system, [(Coordinate("q", row),)]).densities
        assert isinstance(density, Density)
        variances = np.diag(stationary_covariance(system))[[row, row + system.n]]
        if not np.min(variances) > 0.0:
            raise NotApplicable(f"no noise reaches mass {row + 1}, which is at rest")
        q, p = np.sqrt(variances).tolist()
        tol = asked.tol or self.tol_for(system)
        scale = QUESTIONS[question].scale(q, p / float(system.mass[row]))
        return scale, q, partial(certify_curve, scale=scale, of=density, tol=tol)


Linear.register()
