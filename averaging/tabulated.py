"""Densities u(H) that are known between nodes, with tables of what is left when integrated out."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from averaging.energy_density import EnergyDensity, Provenance
from averaging.weyl import POINTS, WeylTable, continued, weyl_table
from fpk.certificate import Measured
from fpk.probe import probed
from fpk.process import Process
from fpk.system import System

Array = NDArray[np.float64]

MOST_NODES = 100
"""Nodes up to which a mesh is halved once more: with 14 points an element, error falls by 2^-14."""


def tabulated(
    system: System,
    process: Process,
    nodes: Array,
    u: Callable[[Array], Array],
    u_error: Callable[[Array], Array],
    *,
    measured: Measured,
    closed: bool = False,
    provenance: Provenance | None = None,
) -> EnergyDensity:
    """Return the density whose u and error of u are smooth between ``nodes``.

    Weyl integrals are tabulated twice: the finer table is the answer, the distance to the other
    one its error. Where the damping depends on the state u is no exponential: the finer table then
    has elements half as long, too, and the error gains all that u was continued by beyond the last
    node, where it falls ever faster.
    """
    varying = process.state_damping
    coarse_nodes = _halved(nodes) if varying and nodes.size < MOST_NODES else nodes
    fine_nodes = _halved(coarse_nodes) if varying else nodes
    tables: dict[tuple[float, str], WeylTable] = {}

    def table(order: float, which: str) -> WeylTable:
        if (order, which) not in tables:
            function = u_error if which == "error" else u
            grid, points = (
                (coarse_nodes, POINTS[0]) if which == "coarse" else (fine_nodes, POINTS[1])
            )
            tables[order, which] = weyl_table(order, grid, function, points=points)
        return tables[order, which]

    # Short of the last node, beyond which the density is dropped. u falls from there on, as p does
    # at the end of every mesh, so that Ψ falls too, at any order, wherever u rises below: its value
    # here bounds what is dropped at any higher energy.
    last = nodes[-1] * (1.0 - 1e-9)

    def weyl(order: float, energy: Array) -> Array:
        return table(order, "answer")(energy)

    def table_error(order: float, energy: Array) -> Array:
        error = np.abs(table(order, "coarse")(energy) - weyl(order, energy))
        if varying:
            error += continued(order, np.minimum(energy, last), fine_nodes, u)
        return np.where(energy < last, error, 0.0)

    def weyl_error(order: float, energy: Array) -> Array:
        dropped = weyl(order, np.array([last]))[0]
        return np.where(energy < last, table(order, "error")(energy), dropped)

    temperature = process.energy_scale / process.degrees_of_freedom
    if varying:
        # u need not fall from H = 0, and may change much faster than over the scale of the energy.
        temperature = min(temperature, probed(process).e_fold(float(nodes[-1])))
    return EnergyDensity(
        system=system,
        nodes=nodes,
        temperature=temperature,
        u=u,
        u_error=u_error,
        weyl=weyl,
        weyl_error=weyl_error,
        measured=measured,
        table_error=table_error,
        closed=closed,
        provenance=provenance or {},
    )


def _halved(nodes: Array) -> Array:
    return np.sort(np.concatenate([nodes, 0.5 * (nodes[1:] + nodes[:-1])]))
