"""Densities of q and p, and the flux of q through a level, from u(H), Eqs. (23), (30)."""

from collections.abc import Callable, Sequence
from functools import partial
from math import ceil, pi

import numpy as np

from averaging.conditional import (
    HIDDEN_RULES,
    Conditional,
    conditional,
    conditionals,
    contact_levels,
    first_touch,
    gibbs_integral,
    hidden_integral,
    stop_panels,
)
from averaging.shell.averages import log_linear_states, shell_averages
from averaging.weyl import Part, StateDensity
from averaging.zero_flux import density_of_energies
from fpk.answer.density import Density, certify_density
from fpk.answer.names import Coordinate, Observable
from fpk.numeric.arrays import DEPTH, Array
from fpk.solvers.line.mesh import DEEP_LAYERS, with_layers
from fpk.system.system import System

RIDGE_WIDTH = 0.2
"""Conditional over unconditional thermal width of a displacement given another displacement, below
which their joint density is a ridge that panels of one thermal displacement do not resolve."""


def back_transformed(source: StateDensity, observable: Observable, *, tol: float) -> Density:
    """Return the density of ``observable``, H or one or two of (q, p), from u(H) = ``source``.

    Momenta and masses without contact are quadratic in H and integrated out exactly, by Weyl
    integrals of u; contact masses that are not observed by quadrature (``energy_only_refusal`` says
    how many). The certificate compares the L1 error with ``tol``.
    """
    system = source.system
    if observable[0].kind == "H":
        solution = source.solution
        # u is smooth between the panels of the solution, T is not next to a contact energy.
        nodes = with_layers(solution.nodes, solution.process.nonsmooth, count=DEEP_LAYERS)

        def error_of_states(energy: Array) -> Array:
            """Return the relative error of T, which may be large next to a contact energy."""
            x, _ = solution.process.on_mesh(energy, float(nodes[-1]))
            return shell_averages(system, x.ravel()).error.reshape(x.shape)

        return density_of_energies(
            observable, solution, (nodes,), error_of_states, tol=tol, added=source.closed
        )
    pdf, pointwise, added = marginal_of(source, observable)
    T, end = source.temperature, source.end

    def panels(c: Coordinate) -> Array:
        if c.kind == "q":
            return displacement_panels(system, c.row, temperature=T, end=end)
        # Panels of at most two thermal momenta, at least 16.
        reach = np.sqrt(2.0 * system.mass[c.row] * end)
        return np.linspace(-reach, reach, max(16, ceil(np.sqrt(2.0 * end / T))) + 1)

    frame = None
    q = tuple(c.row for c in observable if c.kind == "q")
    if len(q) == 2:
        # On a ridge: one displacement, and the deviation of the other from its conditional mean. If
        # only one mass has stops it comes first, so that no stop runs across the panels.
        swapped = q[0] not in system.contact_masses
        first, second = conditionals(system, q[::-1] if swapped else q)
        width = float(np.sqrt(T / second.precision))
        if width <= RIDGE_WIDTH * np.sqrt(T * system.compliance[second.mass, second.mass]):
            reach = float(np.sqrt(2.0 * end / second.precision))
            apart = np.linspace(-reach, reach, ceil(2.0 * reach / width) + 1)
            matrix = np.array([[1.0, 0.0], [second.weights[0], 1.0]])
            along = panels(Coordinate("q", first.mass))
            frame = matrix[::-1] if swapped else matrix, (along, apart)
    return certify_density(
        observable,
        tuple(map(panels, observable)),
        pdf,
        pointwise,
        measured=source.measured,
        tol=tol,
        added_error=added,
        frame=frame,
    )


def marginal_of(
    source: StateDensity, observable: Observable, *, flux_of: float | None = None
) -> tuple[Callable[..., Array], Callable[..., Array], Callable[..., Array]]:
    """Return the density of the observed (q, p), u(H) integrated over the others, and two errors.

    The first two functions map arrays of q and p, one for each coordinate of ``observable`` in its
    order, broadcast together, to the integral and to its whole absolute error; the third maps the
    integral and the same arrays to the error of tables and quadrature alone. If ``flux_of`` is the
    mass m of the observed displacement, the integral is ∫_0^∞ (p/m) f dp, the upcrossings per unit
    time.
    """
    system, T = source.system, source.temperature
    q = [c.row for c in observable if c.kind == "q"]
    hidden = [i for i in system.contact_masses if i not in q]
    order, log_factor, laws, observed = reduction(system, observable, hidden, source.unit)
    if flux_of is not None:  # (p/m) dp = dx, x = p²/2m
        order, log_factor = order + 0.5, log_factor - 0.5 * np.log(2.0 * pi * flux_of)
    coarse, fine = HIDDEN_RULES[min(len(hidden), len(HIDDEN_RULES) - 1)]
    weyl = source.weyl(order)
    widths = np.prod([np.sqrt(2.0 * pi * T / law.precision) for law in laws])

    def marginal(*x: Array, part: Part = "value", points: int = fine) -> Array:
        arrays = np.broadcast_arrays(*(np.asarray(a, dtype=float) for a in x))
        Q, energy = observed([a.ravel() for a in arrays])
        if source.gibbs:
            factor, error = gibbs_integral(system, q, Q, temperature=T, points=points)
            own = error * weyl(energy) if part == "table" else factor * weyl(energy, part)
            result = widths * own
        else:
            f, end = partial(weyl, part=part), source.end
            result = hidden_integral(f, energy, Q, laws, temperature=T, end=end, points=points)
            if part == "table":
                # The grids omit E + V above ``top``. Contact only adds to V, so the omitted
                # integral is at most Ψ(top) times the Gaussian width of each mass.
                top = np.maximum(end, energy + DEPTH * T)
                result = result + len(hidden) * widths * weyl(top)
        return np.asarray(np.exp(log_factor) * result).reshape(arrays[0].shape)

    def added(values: Array, *x: Array) -> Array:
        error = marginal(*x, part="table", points=coarse)
        return error + np.abs(values - marginal(*x, points=coarse)) if hidden else error

    return marginal, lambda *x: marginal(*x, part="error") + added(marginal(*x), *x), added


Observed = Callable[[Sequence[Array]], tuple[Array, Array]]
"""Maps the observed q and p, (N,) each in the order of the observable, to the observed
displacements (displacements, N) and to the energy (N,) of all observed coordinates: other momenta
are 0, other displacements at the minimum of the springs' energy."""


def reduction(
    system: System, observable: Observable, hidden: list[int], unit: float
) -> tuple[float, float, tuple[Conditional, ...], Observed]:
    """Return order ν, ln C, laws and map of p(observed) = C ∫Ψ_ν(E + V(hidden | observed)) dhidden.

    Ψ_ν is the Weyl integral of u: 2ν quadratic coordinates are integrated out exactly, which gives
    C = (2π)^ν/(√det T_lin), det of their quadratic form, T_lin the density of states without
    contact at the energy ``unit``. The laws, whose potentials add up to V, are of the contact
    masses ``hidden`` (0-based) in their order; the map gives the energy E of the coordinates of
    ``observable``, see ``Observed``.
    """
    q, p = ([c.row for c in observable if c.kind == kind] for kind in "qp")
    laws = conditionals(system, [*q, *hidden])
    order = system.n - 0.5 * (len(p) + len(laws))
    log_factor = order * np.log(2.0 * pi) + 0.5 * (
        np.sum(np.log(np.delete(system.mass, p)))
        + np.sum(np.log([law.precision for law in laws]))
        - np.sum(np.log(system.stiffness))
    )
    log_factor = float(log_factor - log_linear_states(system, unit))

    def observed(at: Sequence[Array]) -> tuple[Array, Array]:
        momenta = [(c.row, x) for c, x in zip(observable, at, strict=True) if c.kind == "p"]
        displacements = [x for c, x in zip(observable, at, strict=True) if c.kind == "q"]
        Q = np.array(displacements).reshape(len(q), at[0].size)
        energy = sum((x**2 / (2.0 * system.mass[i]) for i, x in momenta), np.zeros(at[0].size))
        for k, law in enumerate(laws[: len(q)]):
            energy = energy + law.energy(Q[k], law.weights @ Q[:k])
        return Q, energy

    return order, log_factor, laws[len(q) :], observed


def displacement_panels(system: System, mass: int, *, temperature: float, end: float) -> Array:
    """Return panel nodes of q_mass (0-based) up to the energy ``end``, at most a width apart.

    The width is the standard deviation at ``temperature`` without contact. Panels are
    graded beyond every stop of the mass, and about the displacements at which another mass, whose
    width given q_mass is smaller, has its conditional mean at one of its stops.
    """
    law, end_of_all = conditional(system, mass, ()), np.array([end])
    thermal = float(np.sqrt(temperature / law.precision))
    levels = contact_levels(temperature, end)
    nodes = stop_panels(system, mass, width=thermal, end=end, levels=levels)
    parts = [nodes]
    for i in system.contact_masses:
        other = conditional(system, i, (mass,))
        # The width of the other mass, in displacements of this mass.
        if np.sqrt(temperature / other.precision) < thermal * other.weights[0]:
            parts.append(first_touch(law, other, np.zeros((0, 1)), end_of_all, temperature)[0])
    return np.unique(np.clip(np.concatenate(parts), nodes[0], nodes[-1]))
