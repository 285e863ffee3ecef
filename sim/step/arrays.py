"""Plain arrays that the compiled step reads, and the layout of its workspace."""

from typing import Any, NamedTuple

import numpy as np

from fpk.numeric.arrays import Array, Integers

LANES = W = 128
"""Trajectories that one block of the compiled step advances together; fixed when it is compiled."""

MAX_BATCHES = 64
"""Largest number of independent batches of an ensemble; standard errors come from their spread."""

MAP_COLUMNS = 4
"""Columns of the linear map in one compiled loop; its matrix is padded to a multiple of them."""

NARROW = 16
"""Lanes of a group that makes small steps: 16 numbers of 32 bits fill a vector of 64 bytes."""

MAX_TRAJECTORIES = 1 << 24
"""Largest number of trajectories of a seed: each owns 2**40 of the 2**64 words of the sequence."""


class TermArrays(NamedTuple):
    """Damping terms ``p_i' = −scale · Π factors · H^energy · p_i^power``, in powers of momenta."""

    target: Integers  # (terms,), row of p_i in a state (q, p)
    power: Integers  # (terms,), exponent N of p_i
    scale: Array  # (terms,), coefficient in powers of momenta
    energy: Integers  # (terms,), exponent e of H
    first: Integers  # (terms + 1,), index of the first factor of each term, and their number
    factor: Integers  # (factors,), row in (q, p), repeated as often as its power; p_i comes last
    springs: Array  # (n, n), K dt of a scheme that kicks by the springs; else empty


class StepArrays(NamedTuple):
    """Numbers of one step: of the small steps in a long step, and of the long step itself.

    A slot is a mass with one stop or more. Without long steps (``sim.sample.plan``) ``after``,
    ``bend`` and ``reach`` have no rows.
    """

    matrix: Array  # (2n, columns), propagator and noise factor of the linear map, columns padded
    pairs: int  # of normals in a linear map
    maps: int  # linear maps in a step, each with its own pairs of normals
    dt: float  # of a small step, if there are any
    stiffness_matrix: Array  # (n, n)
    half_inverse_mass: Array  # (n,), 1/(2m): energies of momenta
    slot_mass: Integers  # (slots,)
    slot_shift: Array  # (slots,), w h²/m of the modified kick and of the observed q
    stop_slot: Integers  # (stops,), slot of each stop
    stops: Array  # (stops, 5), sign (0: equal on both sides), clearance, stiffness, exponent, law
    terms: Any  # TermArrays; None for constant damping, whose kernel does not read it
    words: int  # random words of a trajectory in one step
    small: int  # small steps in a long step; 1 if all trajectories make the same steps
    long_matrix: Array  # (2n, columns), linear map over the long step
    after: Array  # (stops, 2n padded), rows that map a state to its mean q after the long step
    bend: Array  # (stops, 2n padded), rows that map |q|, |p| to the bound b(x) of ``plan.bends``
    reach: Array  # (stops,), largest displacement by the noise in a long step
    strength: Any  # (steps,) float32, factors on the noise; empty for constant noise


class WatchArrays(NamedTuple):
    """Numbers of the observed state, of the histograms and of the products that are summed.

    The last fields are first rows of quantities in the workspace of a block (in brackets how many),
    after the state (q, p) (2n), the normals of the linear map, and its result (2n).
    """

    half_kick: float  # ½ dt if the observed momentum is in the middle of the kick, else 0
    half_springs: Array  # (n, n), the same times K, of a scheme that kicks by the springs
    cross: Array  # (n, slots), w h² c_ik/m_k
    term_shift: float  # w h² of the processor of the damping terms
    mode_q: Array  # (modes, n), ω_m T_rm m_r: H_m = ½ (mode_q q)² + ½ (mode_p p)²
    mode_p: Array  # (modes, n), T_rm
    rows: Integers  # (histograms, 2), rows of the coordinates; −1: there is no second coordinate
    bins: Integers  # (histograms, 2), bins of each axis
    pieces: Array  # (pieces, 5), low, high, bins, bins per unit, 1 if bins widen from low, else 0
    piece: Integers  # (histograms, 2, 2), index of the first piece of each axis, and its end
    start: Integers  # (histograms,), first bin of each in the counts
    products: Integers  # (moments, 2), rows whose products are summed
    traced: Integers  # rows that are copied to the trace
    contact: int  # (2 slots), g and g' of each slot
    q: int  # (n), observed displacements
    p: int  # (n), observed momenta
    force: int  # (n), total force K q + g(q) at the observed q
    energy: int  # (1), H of the observed state
    modal: int  # (modes), modal energies of the observed state
    damping: int  # (n), forces of the damping terms
    change: int  # (3n), d(q, p)/dt by springs and contacts, and the change of the terms' forces
    work: int  # scratch: (1), or (5) with damping terms
    total: int  # number of rows


def in_blocks(rows: Array) -> Array:
    """Return a copy of ``rows`` (paths, k) as (blocks, k, LANES); row 0 fills up the last block."""
    rows = np.concatenate([rows, np.repeat(rows[:1], -len(rows) % LANES, axis=0)])
    return np.array(rows.T.reshape(rows.shape[1], -1, LANES).transpose(1, 0, 2), order="C")


def in_rows(blocks: Array) -> Array:
    """Return a copy of ``blocks`` (blocks, k, LANES) as rows (blocks · LANES, k), one a lane."""
    return np.array(blocks.transpose(0, 2, 1).reshape(-1, blocks.shape[1]), order="C")
