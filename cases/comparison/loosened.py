"""Default tolerances that an answer misses: the same question at a looser one."""

from collections.abc import Callable, Iterable
from math import ceil, inf, isnan, log10
from typing import TypeVar

from fpk.certificate import Certificate

Answer = TypeVar("Answer")

LOOSEST = 1e-4
"""Largest tolerance that takes the place of a default one that is missed: it is still well below
what simulations resolve."""


def loosened(
    ask: Callable[[float | None], Answer],
    certificates: Callable[[Answer], Iterable[Certificate]],
) -> tuple[Answer, float | None]:
    """Return ``ask(None)``, the answer at default tolerances, where it does not miss its own.

    Else the answer at the least power of ten that its error meets, up to ``LOOSEST``, and that
    tolerance; the first answer and None where no such answer is certified by ``certificates``.
    """
    first = answer = ask(None)
    tol = None
    while errors := [c.missed for c in certificates(answer) if c.missed is not None]:
        if not (missed := max(inf if isnan(error) else error for error in errors)) <= LOOSEST:
            break
        tol = 10.0 ** ceil(log10(missed))
        answer = ask(tol)
    certified = all(certificate.certified for certificate in certificates(answer))
    return (answer, tol) if certified else (first, None)


def note_of(label: str, tol: float) -> str:
    """Return the words by which a run says that a route was certified to ``tol`` only."""
    return f"{label}: certified to {tol:.0e}, as the default tolerance could not be met"
