"""Densities of all observables where the damping depends on the state, group by group of modes."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from averaging.modal.analysis import ModalAnalysis
from averaging.modal.blocks import (
    EnergyDensity,
    Solver,
    marginal,
    product,
    solved_block,
    swapped,
)
from averaging.modal.characteristic import state_density
from averaging.modal.total import total_energy_of
from fpk.density import Density
from fpk.observable import Observable

Array = NDArray[np.float64]
Provenance = Mapping[str, str | float | int]
Block = tuple[int, ...]


def state_dependent_densities(
    modes: ModalAnalysis,
    observables: Sequence[Observable],
    solver: Solver,
    *,
    tol: float,
    provenance: Provenance,
) -> tuple[Density, ...]:
    """Return the densities of modal energies, their sum, displacements and momenta.

    Each group of modes that the damping couples is solved once, to a share of ``tol`` such that
    what rests on all groups meets it.
    """
    assert modes.state is not None
    blocks = modes.state.blocks()
    wanted = {c.index for o in observables for c in o if c.kind == "H"}
    if None in wanted or any(c.kind != "H" for o in observables for c in o):
        needed = blocks
    else:
        needed = tuple(block for block in blocks if wanted & set(block))
    share = 0.5 * tol / len(needed)
    solved = [(block, solved_block(modes, block, solver, tol=share)) for block in needed]
    return tuple(_density(modes, solved, o, tol, provenance) for o in observables)


def _density(
    modes: ModalAnalysis,
    solved: list[tuple[Block, EnergyDensity]],
    observable: Observable,
    tol: float,
    provenance: Provenance,
) -> Density:
    if observable[0].kind != "H":
        return state_density(modes, solved, observable, tol=tol, provenance=provenance)
    index = [c.index for c in observable if c.index is not None]
    if not index:
        found = total_energy_of([energies for _, energies in solved], tol=tol)
    elif len(index) == 1:
        found = _one(solved, index[0])
    else:
        found = _two(solved, index[0], index[1])
    relative = modes.relative_error
    theta = modes.temperature[index] if index else np.array([float(np.sum(modes.temperature))])

    def pointwise(*energies: Array) -> Array:
        p, error = found.values(*energies)
        reach = sum(1.0 + np.asarray(H) / scale for H, scale in zip(energies, theta, strict=True))
        within = [np.minimum(H, x[-1]) for H, x in zip(energies, found.panels, strict=True)]
        # Beyond the last energy, where p is 0, the error is what was dropped: less than at the end.
        dropped = np.abs(found.values(*within)[0] - p)
        return np.asarray(np.abs(error) + relative * reach * np.abs(p) + dropped)

    return Density(
        observable,
        found.panels,
        lambda *energies: found.values(*energies)[0],
        pointwise,
        found.l1_error + relative * (len(index) or modes.n),
        found.certificate,
        provenance,
    )


def _one(solved: list[tuple[Block, EnergyDensity]], mode: int) -> EnergyDensity:
    block, energies = next(pair for pair in solved if mode in pair[0])
    return energies if len(block) == 1 else marginal(energies, block.index(mode))


def _two(solved: list[tuple[Block, EnergyDensity]], first: int, second: int) -> EnergyDensity:
    block, energies = next(pair for pair in solved if first in pair[0])
    if second not in block:
        return product(_one(solved, first), _one(solved, second))
    return energies if block.index(first) == 0 else swapped(energies)
