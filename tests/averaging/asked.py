"""Questions about displacements, and a linear system that they are asked of."""

import fpk
from fpk.answer.method import silent
from fpk.answer.names import Coordinate

TURNED = fpk.System([1, 2], [1, 1.5], [[0.08, 0.06], [-0.04, 0.05]], [0.01, 0.02])
"""Unequal temperatures and an antisymmetric part of the damping."""


def ask(method, question, system, *arguments, tol=None):
    """The certified answer; the first argument is the number of a mass, from 0, but for rates."""
    if question != "relaxation":
        row, *arguments = arguments
        arguments = [(Coordinate("q", row),), *arguments]
    answer = getattr(method, question)(system, *arguments, tol=tol, progress=silent)
    assert answer.certificate.certified, answer.certificate.failures
    return answer
