"""Plain arrays that the compiled step reads."""

from typing import Any, NamedTuple

import numpy as np

from fpk.numeric.arrays import Array, Integers

LANES = W = 128
"""Trajectories that run side by side in one block; a constant of compilation."""

GROUPS = 64
"""Independent batches of trajectories, from which errors are taken; of an ensemble at most."""

COLUMNS = 4
"""Columns of the linear map that one loop joins; its matrix is padded to a multiple."""

NARROW = 16
"""Lanes of a group that makes small steps: one vector of 32-bit numbers."""

MAX_TRAJECTORIES = 1 << 24
"""Trajectories that a seed has words for: each owns 2**40 of the 2**64 words of the sequence."""


class Rows(NamedTuple):
    """First row of each group in the workspace of a block.

    Before them lie the state (q, p), the other columns of the linear map, and its results (2n).
    """

    contact: int  # (2 slots), g and g' of each slot
    q: int  # (n), observed displacements
    p: int  # (n), observed momenta
    force: int  # (n), total force K q + g(q) at the observed q
    energy: int  # (1), H of the observed state
    modal: int  # (modes), modal energies of the observed state
    damping: int  # (n), forces of the damping terms
    change: int  # (3n), rates of change of (q, p) by the springs, and of the terms' forces by them
    work: int  # scratch: 1, and 5 where there are terms
    total: int


class TermArrays(NamedTuple):
    """Damping terms ``p_i' = −scale · Π factors · H^energy · p_i^power``, velocities as momenta."""

    target: Integers  # (terms,), row of p_i in a state (q, p)
    power: Integers  # (terms,)
    scale: Array  # (terms,)
    energy: Integers  # (terms,)
    first: Integers  # (terms + 1,), where the factors of each begin
    factor: Integers  # (factors,), row in a state (q, p), as often as its power; p_i at the end
    springs: Array  # (n, n), kick by the springs times dt; no entries where the map has it


class StepArrays(NamedTuple):
    """Numbers of one step; of a long step those of its small ones, and of the long one itself.

    A slot is a mass that touches something; it may have several stops. Without long steps
    (``sim.sample.plan``) ``after``, ``bend`` and ``reach`` have no rows.
    """

    matrix: Array  # (2n, columns), propagator and factor of the linear map, columns padded
    pairs: int
    maps: int  # linear maps in a step, each with its own pairs of normals
    dt: float
    stiffness_matrix: Array  # (n, n)
    half_inverse_mass: Array  # (n,), 1/(2m): energies of momenta
    slot_mass: Integers  # (slots,)
    slot_shift: Array  # (slots,), w h² / m of the modified kick and of the observed q
    stop_slot: Integers  # (stops,)
    stops: Array  # (stops, 5), sign (0: alike on both sides), clearance, stiffness, exponent, law
    terms: Any  # TermArrays, or None for constant damping: its kernel does not read it
    words: int  # of the stream that a trajectory takes in one call of the step
    small: int  # steps in a long one, 1 where all trajectories make the same
    long_matrix: Array  # (2n, columns), the map over the long step
    after: Array  # (stops, 2n padded), mean displacement after the long step
    bend: Array  # (stops, 2n padded), b by the sizes of the state
    reach: Array  # (stops,), what the noise can add
    strength: Any  # (steps,) float32, factors on the noise; no entries where it is constant


class WatchArrays(NamedTuple):
    """Numbers of the observed state, of the histograms and of the products that are summed."""

    half_kick: float  # share of the kick that belongs to the observed momentum, times dt
    half_springs: Array  # (n, n), the same of the springs
    cross: Array  # (n, slots), w h² c_ik / m_k
    term_shift: float  # w h² of the processor of the damping terms
    mode_q: Array  # (modes, n), ω_m T_rm m_r: H_m = ½ (mode_q q)² + ½ (mode_p p)²
    mode_p: Array  # (modes, n), T_rm
    at: Rows
    rows: Integers  # (histograms, 2), rows of the coordinates, second −1 for one coordinate
    bins: Integers  # (histograms, 2)
    pieces: Array  # (pieces, 5), low, high, bins, bins a unit, and 1 where bins widen, else 0
    piece: Integers  # (histograms, 2, 2), first piece of each axis, and one behind its last
    start: Integers  # (histograms,), first bin of each in the counts
    products: Integers  # (moments, 2), rows whose products are summed
    traced: Integers  # rows that are handed out


def in_blocks(rows: Array) -> Array:
    """Return ``rows`` (paths, k) as blocks (blocks, k, LANES); the first row fills up the last."""
    rows = np.concatenate([rows, np.repeat(rows[:1], -len(rows) % LANES, axis=0)])
    return np.array(rows.T.reshape(rows.shape[1], -1, LANES).transpose(1, 0, 2), order="C")


def in_rows(blocks: Array) -> Array:
    """Return a copy of ``blocks`` (blocks, k, LANES) as rows (paths, k)."""
    return np.array(blocks.transpose(0, 2, 1).reshape(-1, blocks.shape[1]), order="C")
