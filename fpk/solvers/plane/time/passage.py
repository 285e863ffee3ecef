"""First passage of two energies and their slowest relaxation rates.

As functions of the start, u(t) = P(T > t) solves ∂u/∂t = L u with u = 0 on the limit, the mean time
solves L E[T] = −1, and L E[T²] = −2 E[T]; L is the transpose of the operator of the density.
"""

from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.sparse.linalg import LinearOperator, aslinearoperator, eigs

from fpk.answer.certificate import DISTANCE_FACTOR
from fpk.answer.dynamics import BEYOND_RANGE, Passage, Rates, certify_passage, certify_rates
from fpk.answer.names import number_text
from fpk.answer.quantities import Number
from fpk.numeric.arrays import EPS, ROUNDINGS, Array, Complexes
from fpk.numeric.errors import NotCertified, require
from fpk.solvers.plane.elements import Nodes, lu_factors
from fpk.solvers.plane.solution import PlaneSolution, root_spaced_nodes
from fpk.solvers.plane.time.operator import DISTANCE_SHARE, PlaneOperator, PlaneStart, operators
from fpk.solvers.plane.time.transient import KRYLOV_SHARE, krylov_exponential, relative_residual
from fpk.solvers.plane.weight import negligible_rise

FOLDS = 5.0
"""Largest mean rise of −ln w over a panel: elimination amplifies round-off by e^(rise/2)."""
MAX_LIMIT_RISE = 300.0
"""Largest rise of −ln w up to a limit: E T² is then of the order of e^600, in double precision."""
MAX_PLANE_UNKNOWNS = 300_000
"""Largest number of unknowns of a level: its matrices and factors take 3 GB."""
VECTORS = (4, 30)
"""Number of Arnoldi vectors for k eigenvalues: the first times k, plus the second. With few vectors
one of several nearly equal rates may be missed."""
RATES_HEIGHT = 8.0
"""Rise of −ln w by which meshes are longer than for densities, as eigenfunctions grow with H."""


@dataclass(frozen=True)
class PlaneLimit:
    """Limits of H1 and H2, whichever is exceeded first, or of the ``total`` H1 + H2; None: none."""

    first: float | None = None
    second: float | None = None
    total: float | None = None

    @property
    def collapsed(self) -> bool:
        """Whether H1 + H2 is limited: an edge in the coordinates (H, H1/H) of the operator."""
        return self.total is not None

    @property
    def absorbing(self) -> tuple[bool, bool]:
        """Whether the far edge of each coordinate is a limit: of H1 and H2, or of H and H1/H."""
        return self.collapsed or self.first is not None, self.second is not None

    def edge(self, far: Array) -> tuple[Array, Array]:
        """Return points H1, H2 along the limit, (points,) each, up to ``far`` (2,) on an axis
        without limit."""
        t = np.linspace(0.0, 1.0, 41)
        if self.total is not None:
            return self.total * t, self.total * (1.0 - t)
        a, b = (far[k] if x is None else x for k, x in enumerate((self.first, self.second)))
        lines = np.array([[a + 0.0 * t, b * t], [a * t, b + 0.0 * t]])[np.array(self.absorbing)]
        return np.concatenate(lines[:, 0]), np.concatenate(lines[:, 1])

    def nodes(self, stationary: PlaneSolution, rise: float, panels: int) -> Nodes:
        """Return nodes up to the limit, or to −ln w = ``rise`` along an axis without limit.

        They are for H1 and H2, or for H and H1/H if H = H1 + H2 is limited: ``panels`` along each
        axis, more if −ln w of ``stationary`` rises by more than ``FOLDS`` on each.
        """
        if self.total is not None:
            corners = stationary.weight.exponent(*(self.total * np.eye(2)))
            angles = max(panels, int(abs(corners[1] - corners[0]) / FOLDS))
            along = root_spaced_nodes((self.total, 1.0), max(panels, int(corners.max() / FOLDS)))[0]
            return along, np.sin(np.linspace(0.0, 0.5 * np.pi, 1 + angles)) ** 2
        limits = zip((self.first, self.second), stationary.far_ends(rise), strict=True)
        ends = [far if limit is None else limit for limit, far in limits]
        rises = stationary.weight.exponent(*np.diag(ends))
        counts = [max(panels, int(rise / FOLDS)) for rise in rises]
        return root_spaced_nodes(ends, counts[0])[0], root_spaced_nodes(ends, counts[1])[1]


Level = tuple[PlaneOperator, Array, Array, float]
"""An operator; mean, variance, failure rate and then P(T > t) at all times, in an array
(3 + times,); their round-off, likewise; the relative residual."""


def plane_first_passage(
    stationary: PlaneSolution,
    start: PlaneStart,
    limit: PlaneLimit,
    times: Array,
    *,
    tol: float,
    coefficients_error: float = 0.0,
) -> Passage:
    """Return the first passage of ``limit`` from ``start``, with P(T > t) at ``times`` >= 0.

    Process and weight are taken from ``stationary``. Meshes are refined until two levels agree to
    ``tol``, relative to mean, variance and rate and absolute for P, or further levels are
    ``_hopeless``. The part of an initial density beyond the limit has failed at time 0.
    ``coefficients_error`` is the relative error of the coefficients. Raises ``InvalidInput`` for a
    limit whose mean time is beyond double precision, or that takes too many unknowns, and for an
    initial density too narrow for the mesh; raises as ``PlaneSolution.far_ends`` does.
    """
    height = start.height(stationary)
    far = stationary.far_ends(negligible_rise(tol, height))
    lowest = float(np.min(stationary.weight.exponent(*limit.edge(far))))
    given = [x for x in (limit.first, limit.second, limit.total) if x is not None]
    words = ", ".join(map(number_text, given))
    require(not lowest > MAX_LIMIT_RISE, "limit", words, BEYOND_RANGE)
    finer = operators(
        stationary,
        partial(limit.nodes, stationary),
        tol=tol,
        height=max(height, lowest),
        absorbing=limit.absorbing,
        collapsed=limit.collapsed,
    )
    every = [op for op in finer if op.sizes[0] * op.sizes[1] <= MAX_PLANE_UNKNOWNS]
    remedy = "so rare a failure takes more equations than fit into memory; take a lower one"
    require(len(every) > 1, "limit", words, remedy)
    distances = list[float]()
    levels = (_level(op, start, times, tol) for op in every)
    for left, (coarse, fine) in zip(reversed(range(len(every) - 1)), pairwise(levels), strict=True):
        op, values, own, residual = fine
        edge = limit.edge(np.array([x[-1] for x in op.nodes]))
        # Relative error by the coefficients, the weight and the initial density.
        model = coefficients_error * (2.0 + 2.0 * float(stationary.weight.exponent(*edge).min()))
        model += 2.0 * stationary.relative_error * (stationary.degree == 0) + start.l1_error
        size = np.append(np.abs(values[:3]), np.ones(times.size))
        errors = np.abs(values - coarse[1]) + own + model * size
        # Both moments in the variance have the error of the coefficients.
        errors[1] += model * 2.0 * values[0] ** 2
        mean, variance, rate = map(Number, values[:3].tolist(), errors[:3].tolist())
        answer = certify_passage(
            (mean, variance, rate),
            times,
            1.0 - values[3:],
            errors[3:] + DISTANCE_SHARE * np.max(errors[3:], initial=0.0),
            tol=tol,
            residual=float(np.max([residual, coarse[3]])),
            settings={"unknowns": op.matrices[2].size, "degree": op.degree},
        )
        size[:3] = np.abs(coarse[1][:3])
        distances.append(float(np.max(np.abs(values - coarse[1]) / size)))
        if answer.certificate.certified or _hopeless(distances, left, max(tol, model)):
            break
    return answer


def _hopeless(distances: list[float], left: int, tol: float) -> bool:
    """Whether ``left`` further levels gain nothing (distance <= 0.1 ``tol``), or cannot reach it.

    ``distances`` are between successive levels so far. The factor that a level gains is assumed
    to be at best the square of the factor of the level before. The finest levels take a minute.
    """
    if distances[-1] <= tol or len(distances) < 2 or not left:
        return distances[-1] <= 0.1 * tol
    gain = distances[-1] / distances[-2]
    return bool(distances[-1] * gain ** (2 ** (left + 1) - 2) > tol)


def _level(op: PlaneOperator, start: PlaneStart, times: Array, tol: float) -> Level:
    # A common factor on all three avoids underflow for small energies.
    A, M, shares = (part / op.matrices[2].max() for part in op.matrices)
    transposed, dual = (-A.T).tocsc(), start.dual(op)
    backward = lu_factors(transposed)
    sizes = abs(transposed)

    def solved(right: Array) -> tuple[Array, Array, float]:
        """(−Aᵀ)⁻¹ ``right``, its change by one step of iterative refinement, and the residual."""
        first = backward.solve(right)
        change = backward.solve(right - transposed @ first)
        x = first + change
        return x, change, relative_residual(transposed, sizes, x, right)

    T, change, residual = solved(shares)
    square, _, _ = solved(2.0 * (M @ T))
    mean, second = float(dual @ T), float(dual @ square)
    remedy = "the elements do not see so narrow a density; start from rest or louder noise"
    require(mean > 0.0, "start", "stationary", remedy)
    # Round-off: the change by one step of iterative refinement, and at least 1e-14.
    relative = ROUNDINGS * abs(float(dual @ change)) / mean + 1e-14
    # The smallest λ of −A u = λ M u is real and simple; 1/λ is of the order of the longest mean
    # time. For a rare failure λ is far below all other rates.
    longest = np.max(np.abs(T))
    inverse = LinearOperator(A.shape, matvec=lambda u: backward.solve(M @ u) / longest, dtype=float)
    (largest,) = eigs(inverse, k=1, ncv=8, v0=T / longest, tol=0.0, return_eigenvectors=False)
    rate = 1.0 / (largest.real * longest)
    # E T <= t + P(T > t) max E T bounds P(T <= t), accurately enough if failure is rare.
    top, at_zero = float(op.largest(T)), times <= 0.0
    bound = np.where(at_zero, 0.0, (top - mean + times) / top + relative)
    late = bound > KRYLOV_SHARE * tol
    survival, lost = np.ones(times.size), np.where(late, 0.0, bound)
    if start.density is not None:
        survival[at_zero] = float(dual @ lu_factors(M).solve(shares))
    if np.any(late):
        u = krylov_exponential(-transposed, M, shares, times[late], tol=KRYLOV_SHARE * tol)
        survival[late] = u.values @ dual
        lost[late] = np.abs(u.change @ dual) + ROUNDINGS * u.rounding * op.largest(u.values)
        residual = float(np.max([residual, u.residual]))
    values = np.append([mean, second - mean**2, rate], survival)
    rounding = relative * np.array([mean, second + 2.0 * mean**2, rate])
    return op, values, np.append(rounding, lost), residual


def relaxation_rates(
    stationary: PlaneSolution, count: int, *, tol: float, relative: float = 0.0
) -> Rates:
    """Return the ``count`` nonzero eigenvalues of −L with the smallest real parts, ascending.

    Each conjugate pair counts once, with Im λ > 0. L and the weight are taken from ``stationary``.
    Meshes are refined until two levels agree to ``tol``, relative to each rate; ``relative`` is the
    relative error of the coefficients. Raises ``NotCertified`` if fewer than two levels have more
    unknowns than Arnoldi vectors.
    """
    # A rate of the order of the slowest: the smaller b/H² of the energies at their scales.
    scales = np.array(stationary.process.energy_scales)
    b = stationary.process.coefficients(scales[None, :]).diffusion[0]
    shift, sought, answer = float(np.min(np.diag(b) / scales**2)), 2 * count + 2, None
    vectors, levels = VECTORS[0] * sought + VECTORS[1], list[Complexes]()
    for op in operators(
        stationary,
        lambda rise, panels: root_spaced_nodes(stationary.far_ends(rise), panels),
        tol=tol,
        height=RATES_HEIGHT,
    ):
        A, M, shares = op.matrices
        if vectors >= shares.size:
            continue
        factors = lu_factors((shift * M - A).tocsc())
        inverse = LinearOperator(A.shape, matvec=factors.solve, dtype=float) @ aslinearoperator(M)
        start: Array = np.random.default_rng(0).normal(size=shares.size)
        s, X = eigs(inverse, k=sought, ncv=vectors, v0=start, tol=0.0)
        every = 1.0 / s - shift
        # Round-off splits a real double eigenvalue into a pair with small imaginary parts.
        every = np.where(np.abs(every.imag) <= 1e-9 * np.abs(every), every.real, every)
        defect = np.asarray(A @ X + (M @ X) * every)
        terms = np.asarray(abs(A) @ np.abs(X) + (M @ np.abs(X)) * np.abs(every))
        residual = float(np.max(np.abs(defect)) / np.max(terms))
        every = every[np.lexsort((every.imag, every.real))]
        every = every[every.imag >= 0.0]
        levels.append(np.delete(every, np.argmin(np.abs(every))))
        if len(levels) < 2:
            continue
        coarse, values = levels[-2], levels[-1][:count]
        size = np.abs(values)
        errors = DISTANCE_FACTOR * np.abs(coarse - values[:, None]).min(axis=1)
        # Round-off of the largest eigenvalue of the shifted inverse, as an error of each rate.
        errors += 50.0 * EPS * (size + shift) ** 2 / shift
        errors += (relative + 2.0 * stationary.relative_error * (stationary.degree == 0)) * size
        settings = {"unknowns": shares.size, "degree": op.degree}
        answer = certify_rates(values, errors, tol=tol, residual=residual, settings=settings)
        if answer.certificate.certified:
            break
    if answer is None:
        raise NotCertified(f"{count} rates take more unknowns than are affordable")
    return answer
