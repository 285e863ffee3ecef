"""Densities of two energies, of one of them or of their sum at times after a start, with errors.

exp(t A) is applied by shift-and-invert Krylov spaces, one for each group of similar times.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import reduce
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array

from fpk.answer.certificate import Measured, certify
from fpk.answer.dynamics import LARGEST_ERROR, Transient
from fpk.numeric.arrays import EPS, ROUNDINGS, SMALLEST, Array
from fpk.numeric.krylov import krylov
from fpk.numeric.quadrature import gauss_grid, panel_rule
from fpk.solvers.plane.elements import Nodes, lu_factors
from fpk.solvers.plane.solution import PlaneSolution, root_spaced_nodes
from fpk.solvers.plane.time.operator import DISTANCE_SHARE, PlaneOperator, PlaneStart, operators
from fpk.solvers.plane.weight import negligible_rise

BOTH_AXES = (0, 1)
"""Axes of the joint density of both energies; (0,) or (1,): of one energy; (): of the sum."""
MAX_START_HEIGHT = 12.0
"""Largest rise of −ln w up to a start, with whose root errors grow; for higher starts a power of w
is the weight."""
GIVEN_UP = (13, 0.5)
"""Degree of elements from which on an L1 distance above the second number ends the refinement: the
time is too short to be resolved."""
TIME_RATIO = 30.0
"""Largest ratio of times that share one Krylov space, and ratio of the largest time to the shift γ
of (M − γA)⁻¹. Rational functions with one such pole approximate e^(−x) on the half-axis, on any
mesh, with an error that falls by √2 − 1 for each degree (Andersson 1981)."""

KRYLOV_SHARE = 1e-2
"""Tolerance of e^(tA), over the tolerance of the answer."""
KRYLOV_BLOCK = 8
"""Dimensions added to a Krylov space at a time; the change by the last of them is the error."""
MAX_KRYLOV = 160
"""Largest dimension of a Krylov space."""


class KrylovSolution(NamedTuple):
    """g at several times (times, unknowns), with its errors.

    ``change`` (times, unknowns) is the change by the last ``KRYLOV_BLOCK`` dimensions, ``rounding``
    (times,) the round-off relative to the norm √∫ w g², ``residual`` the largest relative residual
    of the linear systems.
    """

    values: Array
    change: Array
    rounding: Array
    residual: float


def relative_residual(matrix: csc_array, sizes: csc_array, x: Array, right: Array) -> float:
    """Return max |r − A ``x``| over max |r| + max |A| |``x``|: r = ``right``, A = ``matrix``;
    ``sizes`` is |A|, of every entry."""
    defect = np.abs(right - matrix @ x)
    return float(np.max(defect) / (np.max(np.abs(right)) + np.max(sizes @ np.abs(x))))


def krylov_exponential(
    A: csc_array, M: csc_array, dual: Array, times: Array, *, tol: float
) -> KrylovSolution:
    """Return g = e^(t M⁻¹A) M⁻¹ ``dual`` at ascending ``times`` > 0, to ``tol`` of √∫ w g².

    ``dual`` (unknowns,) is E φ of the initial density. The eigenvalues of (M − γA)⁻¹ M give the
    rates with the error round-off/γ, which is small for the slow rates of large times. If
    ``MAX_KRYLOV`` dimensions miss ``tol``, ``change`` says by how much. Raises ``NotCertified`` if
    M or M − γA is singular.
    """
    start = lu_factors(M).solve(dual)
    residuals, parts, first = [relative_residual(M, abs(M), start, dual)], [], 0
    while first < times.size:
        last = int(np.searchsorted(times, TIME_RATIO * times[first], side="right"))
        parts.append(_of_group(A, M, start, times[first:last], tol))
        first = last
    *arrays, own = zip(*parts, strict=True)
    values, change, rounding = map(np.concatenate, arrays)
    return KrylovSolution(values, change, rounding, float(np.max([*residuals, *own])))


def _of_group(A: csc_array, M: csc_array, start: Array, times: Array, tol: float) -> KrylovSolution:
    gamma, residuals = float(times[-1]) / TIME_RATIO, [0.0]
    matrix = (M - gamma * A).tocsc()
    factors, sizes, norm = lu_factors(matrix), abs(matrix), np.sqrt(start @ (M @ start))

    def apply(v: Array) -> Array:
        right = M @ v
        x = factors.solve(right)
        residuals.append(relative_residual(matrix, sizes, x, right))
        return x

    for V, H, closed in krylov(apply, start[:, None], MAX_KRYLOV, metric=M.__matmul__):
        k = len(V)
        if not closed and (k < 3 * KRYLOV_BLOCK or k % KRYLOV_BLOCK):
            continue
        fewer = k if closed else k - KRYLOV_BLOCK
        more, rounding, norms = _small_exponential(H[:k], times, gamma)
        change = more.copy()
        change[:, :fewer] -= _small_exponential(H[:fewer, :fewer], times, gamma)[0]
        if float(np.max(np.linalg.norm(change, axis=1) / norms)) <= tol:
            break
    values, lost = norm * more @ V, norm * change @ V
    return KrylovSolution(values, lost, rounding / norms, float(np.max(residuals)))


def _small_exponential(H: Array, times: Array, gamma: float) -> tuple[Array, Array, Array]:
    """e^(tA) e_1 (times, m) with A = (1 − ``H``⁻¹)/``gamma``, (m, m), its round-off, which is an
    absolute error, and its Euclidean norms, (times,) each."""
    s, X = np.linalg.eig(H)
    condition, first = float(np.linalg.cond(X)), np.linalg.solve(X, np.eye(len(H))[0])
    # For s below 1e-3 the factor e^(t(1 − 1/s)/γ) is below e^−999, as t >= γ.
    live = np.abs(s) > 1e-3
    rate = (1.0 - 1.0 / s[live]) / gamma
    # No mode grows, but a small space may have eigenvalues in the right half plane.
    rate = np.minimum(rate.real, 0.0) + 1j * rate.imag
    values = ((np.exp(np.outer(times, rate)) * first[live]) @ X[:, live].T).real
    # A solution that has decayed has no round-off of its own.
    norms = np.maximum(np.linalg.norm(values, axis=1), 1e-200)
    # Eigenvectors have the error ε over the gaps of s, which are γ/t for slow modes.
    return values, EPS * condition * (1.0 + times / gamma), norms


Level = tuple[PlaneOperator, KrylovSolution]
"""An operator on one mesh, and its unknowns at all times."""


def marginal_at(
    op: PlaneOperator, observed: tuple[int, ...], g: Array, at: Sequence[Array]
) -> Array:
    """Return densities (times, ...) of unknowns ``g`` (times, unknowns) of ``op`` at ``at``.

    ``observed`` are the axes of the density: both, one, or none for the sum of the energies. ``at``
    has an array (points,) for each of them, one for the sum, or for both also the axes (m, 1),
    (1, n) of a grid. Densities are 0 outside the mesh.
    """
    if len(observed) == 1:
        y, v = (a.ravel() for a in panel_rule(op.nodes[1 - observed[0]], op.points))
        if observed == (0,):
            return np.asarray(marginal_at(op, BOTH_AXES, g, np.ix_(at[0], y)) @ v)
        return np.asarray(v @ marginal_at(op, BOTH_AXES, g, np.ix_(y, at[0])))
    g = op.spread(g)
    if observed == BOTH_AXES:
        first, second = (op.along(k, H.ravel()) for k, H in enumerate(at))
        if at[0].ndim == 2:
            return np.asarray((first @ g @ second.T) * op.weight(*at))
        values = np.array([np.sum((first @ each) * second, axis=1) for each in g])
        return np.asarray(values.reshape(len(g), -1) * op.weight(*at))
    # ∫ w φ_i(x) ψ_j(H − x) dx, cut where panels end.
    rows = np.zeros((at[0].size, *op.sizes))
    for row, H in zip(rows, at[0], strict=True):
        low, high = max(0.0, H - op.nodes[1][-1]), min(H, op.nodes[0][-1])
        if low < high:
            cuts = np.concatenate([op.nodes[0], H - op.nodes[1]])
            x, v = panel_rule(np.unique(np.clip(cuts, low, high)), op.points)
            x, y = x.ravel(), np.maximum(H - x, 0.0).ravel()
            row[...] = (op.along(0, x).T * (v.ravel() * op.weight(x, y))) @ op.along(1, y)
    return np.asarray(g.reshape(len(g), -1) @ rows.reshape(len(rows), -1).T)


def marginal_grid(
    op: PlaneOperator, observed: tuple[int, ...]
) -> tuple[Sequence[Array], Array, list[float]]:
    """Return a grid of the ``observed`` energies, its quadrature weights, flattened (points,), and
    the last energies of the mesh along the observed axes, or their sum for the sum. The grid is an
    ``at`` of ``marginal_at``, of axes if both are ``observed``."""
    ends = [float(x[-1]) for x in op.nodes]
    if not observed:  # panels equidistant in √H
        x, w = panel_rule(root_spaced_nodes((sum(ends), 1.0), 12)[0], 8)
        return (x.ravel(),), w.ravel(), [sum(ends)]
    axes, grids = gauss_grid([op.nodes[k] for k in observed], points=op.degree + 2)
    area = reduce(np.multiply.outer, [w for _, w in grids]).ravel()
    return axes, area, [ends[k] for k in observed]


def transient_densities(
    stationary: PlaneSolution,
    start: PlaneStart,
    observed: tuple[int, ...],
    times: Array,
    at: tuple[Array, ...],
    *,
    tol: float,
    coefficients_error: Callable[..., Array] = lambda t, *at: np.zeros(at[0].shape),
) -> tuple[Transient, tuple[Level, Level]]:
    """Return the densities of ``observed`` energies at ascending ``times`` > 0 and points ``at``.

    They begin with ``start``; process and weight are taken from ``stationary``. For ``observed``
    and ``at`` see ``marginal_at``. Meshes are refined until two levels agree to ``tol``, in L1 and
    in units of the largest density; their distance is the error. A time too short for the finest
    level is not certified, and has infinite errors. ``coefficients_error(t, *at)`` is the relative
    error of p by the coefficients. Also returned are the last two levels, the coarser first.
    """
    for coarse, fine in pairwise(_levels(stationary, start, times, tol)):
        (op, g), (other_op, other_g) = fine, coarse
        axes, area, ends = marginal_grid(op, observed)
        points = [x.ravel() for x in np.broadcast_arrays(*axes)]
        solutions = (op, g.values), (other_op, other_g.values), (op, g.change)
        every = (marginal_at(op, observed, g, axes) for op, g in solutions)
        p, other, change = (values.reshape(times.size, -1) for values in every)
        lost = np.abs(p - other) + np.abs(change)
        largest, distance = np.max(np.abs(p), axis=1), lost @ area
        mass = g.values @ op.matrices[2]
        # The true round-off was measured as up to 3 times the estimate.
        rounding = ROUNDINGS * g.rounding + 2.0 * np.abs(mass - 1.0)
        highest = np.max(lost, axis=1) + rounding * largest
        values, coarser, change = (marginal_at(op, observed, g, at) for op, g in solutions)
        # Beyond the mesh the density is less than at its end.
        within = tuple(np.clip(x, 0.0, end) for x, end in zip(at, ends, strict=True))
        outside = np.any([x != y for x, y in zip(at, within, strict=True)], axis=0)
        beyond = np.abs(marginal_at(op, observed, g.values, within)) * outside
        errors = np.abs(values - coarser) + np.abs(change) + beyond
        errors += DISTANCE_SHARE * highest[:, None]
        errors = np.maximum(errors, (rounding * largest)[:, None])
        errors += np.abs(values) * np.array([coefficients_error(t, *at) for t in times])
        model = (np.abs(p) * np.array([coefficients_error(t, *points) for t in times])) @ area
        unresolved = ~(distance <= LARGEST_ERROR)
        errors = np.where(unresolved[:, None], np.inf, errors)
        errors = np.where(np.min(np.broadcast_arrays(*at), axis=0) < 0.0, 0.0, errors) + SMALLEST
        l1 = distance + model + rounding + start.l1_error
        farther = zip(points, marginal_grid(other_op, observed)[2], strict=True)
        tail = np.abs(p * np.any([x > end for x, end in farther], axis=0)) @ area
        absolute = float(np.max(highest / largest))
        short = (f"the time {t:.4g} is too short for the mesh" for t in times[unresolved])
        measured = Measured(
            l1_error=float(np.max([*l1, absolute])),
            mass_defect=float(np.max(np.abs(mass - 1.0))),
            minimum=float(np.min(p.min(axis=1) / largest)),
            residual=float(np.max([g.residual, other_g.residual])),
            tail_mass=float(np.max(tail)),
            absolute_error=absolute,
            failures=tuple(short),
        )
        settings = {
            "unknowns": op.sizes[0] * op.sizes[1],
            "degree": op.degree,
            "L1 error at the first time": float(l1[0]),
            "L1 error at the last time": float(l1[-1]),
        }
        certificate = certify(measured, tol=tol)
        answer = Transient(times, values, errors, "numerical", certificate, settings)
        degree, least = GIVEN_UP
        if certificate.certified or (op.degree >= degree and float(np.max(distance)) > least):
            break
    return answer, (coarse, fine)


def _levels(
    stationary: PlaneSolution, start: PlaneStart, times: Array, tol: float
) -> Iterator[Level]:
    height, least = start.height(stationary), np.zeros(2)
    share = min(1.0, MAX_START_HEIGHT / max(height, MAX_START_HEIGHT), 1.0 / start.factor)
    if start.density is not None:
        least = np.array([x[-1] for x in start.density.nodes])

    def nodes(rise: float, panels: int) -> Nodes:
        longer = 1.0 + 0.03 * (rise - negligible_rise(tol, height))
        return root_spaced_nodes(np.maximum(stationary.far_ends(rise), least * longer), panels)

    for op in operators(stationary, nodes, tol=tol, height=height, share=share):
        A, M, _ = op.matrices
        yield op, krylov_exponential(A, M, start.dual(op), times, tol=KRYLOV_SHARE * tol)
