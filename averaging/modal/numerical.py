"""Densities of modal energies from numerical solutions of each mode's equation, (11) and (19)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from averaging.modal.analysis import ModalAnalysis
from averaging.modal.process import mode_process, modes_process
from averaging.quadrature import QuadratureSolution, solve_by_quadrature
from fpk.certificate import Certificate
from fpk.density import Density
from fpk.line.stationary import solve_stationary
from fpk.observable import Observable
from fpk.plane.stationary import solve_plane

Array = NDArray[np.float64]
Provenance = Mapping[str, str | float | int]


@dataclass(frozen=True)
class _Mode:
    """One factor of p(H_1, …): its nodes, values, errors and checks."""

    nodes: Array
    density: Callable[[Array], Array]
    pointwise: Callable[[Array], Array]
    l1_error: float
    certificate: Certificate


def by_quadrature(
    modes: ModalAnalysis, observable: Observable, *, tol: float, provenance: Provenance
) -> Density:
    """Return p(H_i) or p(H_i, H_j) by (11), mode by mode: b_ij = 0 and s_i(H_i), so they factor."""
    share = tol / len(observable)
    processes = [mode_process(modes, c.index or 0) for c in observable]
    solved = [solve_by_quadrature(process, tol=share) for process in processes]
    return _product(observable, [_of_quadrature(s) for s in solved], modes, provenance)


def by_elements(
    modes: ModalAnalysis, observable: Observable, *, tol: float, provenance: Provenance
) -> Density:
    """Return p(H_i) or p(H_i, H_j) by finite elements for the FPK equation (19) of these modes."""
    index = [c.index or 0 for c in observable]
    if len(index) == 2:
        return _by_plane_elements(modes, observable, index, tol=tol, provenance=provenance)
    solved = solve_stationary(mode_process(modes, index[0]), tol=tol)
    mode = _Mode(
        nodes=solved.nodes,
        density=solved.density,
        pointwise=solved.pointwise_error,
        l1_error=solved.l1_error,
        certificate=solved.certificate,
    )
    found = {"degree": solved.degree, "elements": solved.nodes.size - 1}
    return _product(observable, [mode], modes, {**provenance, **found})


def _by_plane_elements(
    modes: ModalAnalysis,
    observable: Observable,
    index: list[int],
    *,
    tol: float,
    provenance: Provenance,
) -> Density:
    solved = solve_plane(modes_process(modes, index), tol=tol)
    theta, relative = modes.temperature[index], modes.relative_error

    def pointwise(first: Array, second: Array) -> Array:
        reach = 2.0 + np.asarray(first) / theta[0] + np.asarray(second) / theta[1]
        rounding = relative * reach * np.abs(solved.density(first, second))
        return np.asarray(solved.pointwise_error(first, second) + rounding)

    return Density(
        observable,
        solved.nodes,
        solved.density,
        pointwise,
        solved.l1_error + 2.0 * relative,
        solved.certificate,
        {**provenance, "unknowns": solved.unknowns},
    )


def _of_quadrature(solution: QuadratureSolution) -> _Mode:
    def density(energy: Array) -> Array:
        return np.asarray(np.exp(solution.log_density(np.asarray(energy, dtype=float))))

    return _Mode(
        nodes=solution.nodes,
        density=density,
        pointwise=lambda energy: solution.l1_error * density(energy),
        l1_error=solution.l1_error,
        certificate=Certificate(
            mass_defect=solution.mass_defect,
            minimum=0.0,
            residual=0.0,
            tail_mass=solution.tail_mass,
        ),
    )


def _product(
    observable: Observable, factors: list[_Mode], modes: ModalAnalysis, provenance: Provenance
) -> Density:
    """Independent modes: densities multiply, relative and L1 errors add.

    The round-off of the modes themselves moves the rate of each by their relative error.
    """
    relative = modes.relative_error

    def pdf(*energies: Array) -> Array:
        values = [f.density(np.asarray(H)) for f, H in zip(factors, energies, strict=True)]
        return np.asarray(reduce(np.multiply, values))

    def pointwise(*energies: Array) -> Array:
        values = [f.density(np.asarray(H)) for f, H in zip(factors, energies, strict=True)]
        errors = [f.pointwise(np.asarray(H)) for f, H in zip(factors, energies, strict=True)]
        total: Array = np.zeros(np.broadcast_shapes(*(v.shape for v in values)))
        for k, (error, H) in enumerate(zip(errors, energies, strict=True)):
            theta = modes.temperature[observable[k].index or 0]
            own = error + relative * (1.0 + np.asarray(H) / theta) * values[k]
            total = total + reduce(np.multiply, [v for i, v in enumerate(values) if i != k], own)
        return total

    checks = [f.certificate for f in factors]
    certificate = replace(
        checks[0],
        mass_defect=sum(c.mass_defect for c in checks),
        minimum=min(c.minimum for c in checks),
        tail_mass=sum(c.tail_mass for c in checks),
    )
    return Density(
        observable,
        tuple(f.nodes for f in factors),
        pdf,
        pointwise,
        sum(f.l1_error + relative for f in factors),
        certificate,
        provenance,
    )
