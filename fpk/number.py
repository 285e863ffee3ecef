"""A number that carries its error."""

from dataclasses import dataclass

import numpy as np

SMALLEST = float(np.finfo(float).tiny)
"""Smallest number (2e-308) with full relative accuracy: what is less is known to no better."""


@dataclass(frozen=True)
class Number:
    """A number and its error: an estimate of the numerical one, or one standard error.

    An example::

        rms = fpk.solve(system, ["q2"], methods=["integrable"])["q2"].rms()
        print(f"{rms.value:.6f} ± {rms.error:.0e}")
    """

    value: float
    error: float
