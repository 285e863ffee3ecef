"""Densities u(H) that are known between nodes, with tables of what is left when integrated out."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from averaging.energy_density import EnergyDensity, Provenance
from averaging.shell.ratios import energy_shell
from averaging.weyl import WeylTable, continued, weyl_table
from fpk.certificate import Certificate
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
    l1_error: float,
    certificate: Certificate,
    provenance: Provenance | None = None,
) -> EnergyDensity:
    """Return the density whose u and error of u are smooth between ``nodes``.

    Where the damping depends on the state u is no exponential: Weyl integrals are tabulated on
    elements half as long too, which are the answer then, and their error gains the distance to the
    others and all that u was continued by beyond the last node, where it falls ever faster.
    """
    varying = process.state_damping
    coarse_nodes = _halved(nodes) if varying and nodes.size < MOST_NODES else nodes
    fine_nodes = _halved(coarse_nodes) if varying else nodes

    @lru_cache
    def table(order: float, of_error: bool) -> WeylTable:
        return weyl_table(order, fine_nodes, u_error if of_error else u)

    @lru_cache
    def coarse(order: float) -> WeylTable:
        return weyl_table(order, coarse_nodes, u)

    # Short of the last node, beyond which the density is dropped. u falls from there on, as p does
    # at the end of every mesh, so that Ψ falls too, at any order, wherever u rises below: its value
    # here bounds what is dropped at any higher energy.
    last = nodes[-1] * (1.0 - 1e-9)

    def weyl(order: float, energy: Array) -> Array:
        return table(order, False)(energy)

    def weyl_error(order: float, energy: Array) -> Array:
        dropped = weyl(order, np.array([last]))[0]
        error = table(order, True)(energy)
        if varying:
            error = error + np.abs(coarse(order)(energy) - weyl(order, energy))
            error += continued(order, np.minimum(energy, last), fine_nodes, u)
        return np.where(energy < last, error, dropped)

    temperature = process.energy_scale / process.degrees_of_freedom
    if varying:
        # u need not fall from H = 0, and may change much faster than over the scale of the energy.
        temperature = min(temperature, probed(process).e_fold(float(nodes[-1])))
    return EnergyDensity(
        system=system,
        shell=energy_shell(system),
        nodes=nodes,
        temperature=temperature,
        u=u,
        u_error=u_error,
        weyl=weyl,
        weyl_error=weyl_error,
        l1_error=l1_error,
        certificate=certificate,
        provenance=provenance or {},
    )


def _halved(nodes: Array) -> Array:
    return np.sort(np.concatenate([nodes, 0.5 * (nodes[1:] + nodes[:-1])]))
