"""Elements of one energy and their solutions, and how a mesh of them grows."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fpk.line.elements import Form
from fpk.line.null_vectors import Solved, solved_elements
from fpk.line.rules import contact_rule, element_rule
from fpk.process import Coefficients, Process

Array = NDArray[np.float64]

AT_ONCE = 10_000
"""Elements whose coefficients are evaluated at once: a hundred quadrature points for each of ten
energies of each are 80 MB."""


class SolvedElements(NamedTuple):
    """Solved elements, every array (elements, ...); concatenated as the mesh grows."""

    left: Array
    right: Array
    solved: Solved
    coefficient_error: Array  # largest relative error of the coefficients at its points
    log_states: Array  # ln T at its right end


def solve_elements(
    process: Process, left: Array, right: Array, degree: int, form: Form
) -> SolvedElements:
    """Solve the elements between ``left`` and ``right`` in ``degree`` and in the enriched one.

    The exact solution has J = 0 at every point, so that any points serve the Galerkin equations.
    Integrals of p are another matter: above an energy where contact begins T has half-integer
    powers, and the element that begins there has points of its own for them.
    """
    if left.size > AT_ONCE:
        parts = np.array_split(np.arange(left.size), -(-left.size // AT_ONCE))
        return _joined([solve_elements(process, left[k], right[k], degree, form) for k in parts])
    rule, contact = element_rule(degree), contact_rule(degree)
    lengths = right - left
    begins = np.array([k for k, H in enumerate(left.tolist()) if H in process.nonsmooth], np.intp)
    row = np.full(left.size, -1)
    row[begins] = np.arange(begins.size)
    energy = left[:, None] + lengths[:, None] * rule.share
    inner = left[begins, None] + lengths[begins, None] * contact.share
    flat = process.coefficients(np.concatenate([energy.ravel(), inner.ravel(), right]))
    c = Coefficients(*(part[: energy.size].reshape(energy.shape) for part in flat))
    log_states = flat.log_density_of_states[energy.size : -left.size].reshape(inner.shape)
    solved = Solved(*solved_elements(c, lengths, row, log_states, rule, contact, form == "flux"))
    # The flux form asks for no derivative of b.
    error = (c.relative_error if form == "flux" else c.relative_error + c.slope_error).max(axis=1)
    if begins.size:
        at_inner = flat.relative_error[energy.size : -left.size].reshape(inner.shape)
        error[begins] = np.maximum(error[begins], at_inner.max(axis=1))
    return SolvedElements(left, right, solved, error, flat.log_density_of_states[-left.size :])


def merged(old: SolvedElements, new: SolvedElements, keep: NDArray[np.bool_]) -> SolvedElements:
    """Return the elements of ``old`` to ``keep`` and the ``new`` ones, ascending."""
    joined = _joined([_picked(old, keep), new])
    return _picked(joined, np.argsort(joined.left))


def _picked(e: SolvedElements, index: NDArray[Any]) -> SolvedElements:
    solved = Solved(*(part[index] for part in e.solved))
    rest = {name: getattr(e, name)[index] for name in e._fields if name != "solved"}
    return SolvedElements(solved=solved, **rest)


def _joined(parts: Sequence[SolvedElements]) -> SolvedElements:
    solved = Solved(*map(np.concatenate, zip(*(part.solved for part in parts), strict=True)))
    names = [name for name in SolvedElements._fields if name != "solved"]
    rest = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return SolvedElements(solved=solved, **rest)
