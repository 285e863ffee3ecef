"""Certified finite element solution of the stationary FPK equation of one energy.

A tolerance is given, not a mesh: degree and mesh adapt until the estimate of the L1 error is met.
No boundary condition is imposed at H = 0 (an entrance boundary) nor at the far end: zero flux is
natural. The equation is solved from its coefficients alone, never from the known solution.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fpk.density import Certificate
from fpk.elements import (
    Form,
    LocalSolutions,
    gauss_rule,
    local_density,
    local_solutions,
    shape_functions,
)
from fpk.mesh import Survey, initial_nodes, split_points, survey, tail_bound, truncation_energy
from fpk.process import Coefficients, DiffusionProcess

Array = NDArray[np.float64]

ENRICHMENT = 2
"""Degrees by which the comparison solution exceeds the answer."""
SAFETY = 2.0
"""Factor on the distance to the comparison solution: at an algebraic singularity of order r the
enriched solution keeps the share (p/(p+2))^(2r+2) of the error, at most a half for p >= 4."""
MOST_ROUNDS = 40
MOST_ELEMENTS = 20_000
ROUND_OFF = 4e-16
NEGATIVE = -1e-14
"""Smallest p / max p that counts as round-off."""
NET_FLUX = 1e-10
"""Largest net over one-way flux that counts as round-off: in an element over which p changes by
the share ε, drift and diffusion cancel terms 1/ε larger, and grading goes down to about 1e-6."""


@dataclass(frozen=True, eq=False)
class StationarySolution:
    """Finite element density p(H) with its error estimate and certificate.

    ``nodes`` (elements + 1,); ``coefficients_u`` (elements, degree + 1) of u, with p = u or p = T u
    by ``form``, to be multiplied by exp(``log_scale``) (elements,); the enriched twin of both is
    kept for the pointwise error. ``l1_error`` estimates ∫|p_h − p| on (0, ∞).
    """

    process: DiffusionProcess
    form: Form
    degree: int
    nodes: Array
    coefficients_u: Array
    log_scale: Array
    enriched_u: Array
    enriched_log_scale: Array
    coefficient_error: float
    l1_error: float
    certificate: Certificate

    @property
    def unknowns(self) -> int:
        """Degrees of freedom of the global finite element space."""
        return self.degree * (self.nodes.size - 1) + 1

    def phase_space_density(self, energy: Array) -> Array:
        """p_h/T (up to the constant left out of ln T) at energies of any shape; 0 outside."""
        u = self._expand(self.coefficients_u, self.log_scale, self.degree, energy)
        if self.form == "flux":
            return u
        return u * np.exp(-self._log_states(energy))

    def phase_space_error(self, energy: Array) -> Array:
        """Estimate of |p_h − p|/T at energies of any shape."""
        return self._error(energy) * (
            1.0 if self.form == "flux" else np.exp(-self._log_states(energy))
        )

    def density(self, energy: Array) -> Array:
        """p_h at energies of any shape; 0 outside the mesh."""
        u = self._expand(self.coefficients_u, self.log_scale, self.degree, energy)
        return u * self._weight(energy)

    def pointwise_error(self, energy: Array) -> Array:
        """Estimate of |p_h − p| at energies of any shape."""
        return self._error(energy) * self._weight(energy)

    def _error(self, energy: Array) -> Array:
        """Error of u: distance to the enriched solution and what shifts all of p alike."""
        u = self._expand(self.coefficients_u, self.log_scale, self.degree, energy)
        better = self._expand(
            self.enriched_u, self.enriched_log_scale, self.degree + ENRICHMENT, energy
        )
        floor = self.coefficient_error + self.certificate.tail_mass + ROUND_OFF * self.nodes.size
        return np.asarray(SAFETY * np.abs(u - better) + floor * np.abs(u))

    def _log_states(self, energy: Array) -> Array:
        safe = np.clip(energy, np.finfo(float).tiny, self.nodes[-1])
        return self.process.coefficients(safe.ravel()).log_density_of_states.reshape(energy.shape)

    def _weight(self, energy: Array) -> Array:
        if self.form == "drift-diffusion":
            return np.ones(np.shape(energy))
        return np.exp(self._log_states(np.asarray(energy, dtype=float)))

    def _expand(self, u: Array, log_scale: Array, degree: int, energy: Array) -> Array:
        x = np.asarray(energy, dtype=float).ravel()
        k = np.clip(np.searchsorted(self.nodes, x, side="right") - 1, 0, self.nodes.size - 2)
        t = (x - self.nodes[k]) / (self.nodes[k + 1] - self.nodes[k])
        phi, _ = shape_functions(degree, t)
        value = np.einsum("jx,xj->x", phi, u[k]) * np.exp(log_scale[k])
        inside = (x >= self.nodes[0]) & (x <= self.nodes[-1])
        return np.where(inside, value, 0.0).reshape(np.shape(energy))


class _Elements(NamedTuple):
    """Solved elements, each array or record indexed by element; concatenated as the mesh grows."""

    left: Array
    right: Array
    base: LocalSolutions
    better: LocalSolutions
    values: Array  # densities of mass 1 at the Gauss points, of the answer ...
    better_values: Array  # ... and of the enriched twin
    coefficient_error: Array  # largest relative error of the coefficients


def solve_stationary(
    process: DiffusionProcess, *, tol: float = 1e-10, form: Form = "flux", degree: int | None = None
) -> StationarySolution:
    """Return the stationary density to the L1 tolerance ``tol``, adapting the mesh.

    The degree follows from ``tol`` unless given. The answer is certified or says what failed.
    Raises ``NotCertified`` where no stationary density exists.
    """
    degree = int(np.clip(round(-np.log10(tol)), 3, 12)) if degree is None else degree
    view = survey(process)
    end = truncation_energy(view, 1e-2 * tol)
    nodes = initial_nodes(view, end, process.nonsmooth)
    elements = _solve(process, nodes[:-1], nodes[1:], degree, form)
    special = np.array([0.0, *process.nonsmooth])
    for _ in range(MOST_ROUNDS):
        solution, indicator = _assemble(process, view, elements, degree, form, tol)
        marked = indicator > 0.1 * tol / indicator.size
        if not marked.any() or indicator.size > MOST_ELEMENTS:
            break
        left, right = elements.left[marked], elements.right[marked]
        cut = split_points(left, right, special)
        if np.any((cut <= left) | (cut >= right)):
            break
        new = _solve(
            process, np.concatenate([left, cut]), np.concatenate([cut, right]), degree, form
        )
        elements = _merged(elements, new, ~marked)
    return solution


def solve_on_mesh(
    process: DiffusionProcess, nodes: Array, degree: int, *, form: Form = "flux"
) -> StationarySolution:
    """Return the finite element solution on a given mesh, for convergence studies."""
    elements = _solve(process, nodes[:-1], nodes[1:], degree, form)
    return _assemble(process, survey(process), elements, degree, form, np.inf)[0]


def _solve(
    process: DiffusionProcess, left: Array, right: Array, degree: int, form: Form
) -> _Elements:
    # Each degree has its own Gauss points, so that their distance shows quadrature errors too.
    degrees = (degree, degree + ENRICHMENT)
    grids = [left[:, None] + (right - left)[:, None] * gauss_rule(k)[0] for k in degrees]
    flat = process.coefficients(np.concatenate([grid.ravel() for grid in grids]))
    c, finer = (
        Coefficients(*(part.reshape(grid.shape) for part in parts))
        for grid, parts in zip(
            grids,
            zip(*(np.split(part, [grids[0].size]) for part in flat), strict=True),
            strict=True,
        )
    )
    base = local_solutions(c, right - left, degree, form)
    better = local_solutions(finer, right - left, degree + ENRICHMENT, form)
    values, better_values = (
        local_density(c, local, rule=degree, form=form) for local in (base, better)
    )
    error = c.relative_error.max(axis=1)
    return _Elements(left, right, base, better, values, better_values, error)


def _merged(old: _Elements, new: _Elements, keep: NDArray[np.bool_]) -> _Elements:
    order = np.argsort(np.concatenate([old.left[keep], new.left]))

    def joined(a: Array, b: Array) -> Array:
        return np.concatenate([a[keep], b])[order]

    def record(a: LocalSolutions, b: LocalSolutions) -> LocalSolutions:
        fields = ("u", "log_factor", "residual", "net_flux", "one_way")
        return LocalSolutions(*(joined(getattr(a, f), getattr(b, f)) for f in fields))

    return _Elements(
        left=joined(old.left, new.left),
        right=joined(old.right, new.right),
        base=record(old.base, new.base),
        better=record(old.better, new.better),
        values=joined(old.values, new.values),
        better_values=joined(old.better_values, new.better_values),
        coefficient_error=joined(old.coefficient_error, new.coefficient_error),
    )


def _chain(local: LocalSolutions) -> tuple[Array, Array, Array]:
    """Signs and logs of the elements' scales of u, and logs of their masses.

    The scales make u continuous, the masses sum to one, and where mass is most u is positive.
    """
    leaving, entering = local.u[:-1, 1], local.u[1:, 0]
    tiny = np.finfo(float).tiny
    steps = np.log(np.maximum(np.abs(leaving), tiny)) - np.log(np.maximum(np.abs(entering), tiny))
    log_scale = np.concatenate([[0.0], np.cumsum(steps)])
    sign = np.concatenate([[1.0], np.cumprod(np.where(leaving * entering < 0, -1.0, 1.0))])
    log_mass = log_scale + local.log_factor
    top = np.argmax(log_mass)
    sign *= sign[top]
    total = log_mass[top] + np.log(np.sum(sign * np.exp(log_mass - log_mass[top])))
    return sign, log_scale - total, log_mass - total


def _assemble(
    process: DiffusionProcess,
    view: Survey,
    e: _Elements,
    degree: int,
    form: Form,
    tol: float,
) -> tuple[StationarySolution, Array]:
    """Scale the elements to a global solution; return it with the error indicator per element."""
    sign, scale, log_mass = _chain(e.base)
    better_sign, better_scale, better_log_mass = _chain(e.better)
    lengths = e.right - e.left
    weights = lengths[:, None] * gauss_rule(degree)[1]
    share, better_share = sign * np.exp(log_mass), better_sign * np.exp(better_log_mass)
    p = e.values * share[:, None]
    distance = np.sum(weights * np.abs(p - e.better_values * better_share[:, None]), axis=1)
    shape = np.abs(share) * np.sum(weights * np.abs(e.values - e.better_values), axis=1)
    # A wrong step between two neighbours moves the smaller of the masses on its sides.
    step = np.abs(np.diff(log_mass) - np.diff(better_log_mass))
    below = np.cumsum(np.abs(share))[:-1]
    moved = step * np.minimum(below, np.maximum(1.0 - below, 0.0))
    indicator = shape + np.concatenate([moved, [0.0]]) + np.concatenate([[0.0], moved])

    end_value = abs(float(e.base.u[-1, 1])) * np.exp(scale[-1])
    if form == "flux":
        end = process.coefficients(e.right[-1:])
        end_value *= float(np.exp(end.log_density_of_states[0]))
    tail = tail_bound(view, float(e.right[-1]), end_value)
    coefficient_error = _coefficient_error(e.coefficient_error, np.abs(share))
    round_off = ROUND_OFF * (lengths.size + degree**2)
    estimate = SAFETY * float(distance.sum()) + 2.0 * tail + coefficient_error + round_off
    lowest = p.min(axis=1)
    minimum = float(lowest.min() / p.max())
    indicator = np.where(lowest < NEGATIVE * p.max(), np.inf, indicator)
    residual = float(e.base.residual.max())
    net_flux = float(np.max(np.abs(share) * e.base.net_flux) / np.max(share * e.base.one_way))
    checks = {
        f"the density falls to {minimum:.2g} of its maximum": minimum < NEGATIVE,
        f"the estimated error {estimate:.2g} exceeds the tolerance {tol:.2g}": not estimate <= tol,
        f"the algebraic residual is {residual:.2g}": not residual < 1e-13,
        f"the net flux is {net_flux:.2g} of the one-way flux": not net_flux < NET_FLUX,
        "the density does not fall off at the end of the mesh": not np.isfinite(tail),
    }
    certificate = Certificate(
        mass_defect=abs(float(np.sum(weights * p)) - 1.0),
        minimum=minimum,
        residual=residual,
        tail_mass=tail,
        net_flux=net_flux,
        failures=tuple(words for words, failed in checks.items() if failed),
    )
    solution = StationarySolution(
        process,
        form,
        degree,
        np.append(e.left, e.right[-1]),
        sign[:, None] * e.base.u,
        scale,
        better_sign[:, None] * e.better.u,
        better_scale,
        coefficient_error,
        estimate,
        certificate,
    )
    return solution, indicator


def _coefficient_error(relative: Array, share: Array) -> float:
    """L1 effect of the relative quadrature errors of s and b, which shift d ln p/dH by as much.

    Their effect on ln p is bounded by the error times the fall of ln p over the bulk of the
    mass, about one per energy scale; the worst element of each counts by its share of the mass.
    """
    return float(2.0 * np.sum(share * relative))
