"""A number that carries its error."""

from dataclasses import dataclass
from typing import Literal

ErrorKind = Literal["numerical", "sampling"]
"""Estimate of a numerical error, or one standard error of sampling."""


@dataclass(frozen=True)
class Number:
    """A number and its error: an estimate of the numerical one, or one standard error.

    An example::

        rms = fpk.solve(system, ["q2"], methods=["integrable"])["q2"].rms()
        print(f"{rms.value:.6f} ± {rms.error:.0e}")
    """

    value: float
    error: float
