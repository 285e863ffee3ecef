"""A number that carries its error."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Number:
    """A number and its error: an estimate of the numerical one, or one standard error."""

    value: float
    error: float
