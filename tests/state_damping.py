"""The damping matrix of a state, term by term: what tests of damping compare with."""

import numpy as np


def damping_at(system, q, p):
    """Return c(q, p), (..., n, n), at displacements and momenta (..., n)."""
    c = np.broadcast_to(system.damping, (*q.shape[:-1], system.n, system.n)).copy()
    for term in system.damping_terms:
        c[..., term.row, term.column] += term.value(q, p / system.mass, system.hamiltonian(q, p))
    return c
