"""Types of arrays, whose shapes stand in the docstrings, and the precision of their numbers."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

EPS = float(np.finfo(float).eps)
"""Distance of 1 to the next number, 2.2e-16: twice the largest relative round-off."""
ROUND_OFF = 1e-12
"""Share of its largest part below which a sum whose parts cancel, a rate of decay or an eigenvalue
counts as round-off, of input written with twelve digits or more."""
SMALLEST = float(np.finfo(float).tiny)
"""Smallest number (2e-308) with full relative accuracy: what is less is known to no better."""
ROUNDINGS = 8.0
"""Roundings that are stated of a sum, for each of its terms that cancel."""
BLOCK_SIZE = 4_000_000
"""Numbers of intermediate results that are held at once: 32 MB."""
DEPTH = 40.0
"""Energies above the lowest, in kT, that Gibbs integrals reach: beyond lies about e^−40 = 4e-18."""
