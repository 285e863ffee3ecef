"""Types of arrays (docstrings give their shapes) and the precision of double arithmetic."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

EPS = float(np.finfo(float).eps)
"""Distance from 1 to the next double, 2.2e-16: twice the largest relative error of one rounding."""
ROUND_OFF = 1e-12
"""Relative round-off of input written with twelve digits: a sum of terms that cancel, a decay rate
or an eigenvalue counts as zero below this share of its largest term."""
SMALLEST = float(np.finfo(float).tiny)
"""Smallest normal double, 2.2e-308: smaller numbers lose relative accuracy."""
LARGEST_LOG = 700.0
"""Largest x of which e^x is computed: 1e304 leaves some decades to the largest double, 1.8e308."""
ROUNDINGS = 8.0
"""Stated round-off of a sum with cancelling terms, over ``EPS`` times the sum of their sizes."""
BLOCK_SIZE = 4_000_000
"""Largest number of entries of an intermediate array: 32 MB of doubles."""
DEPTH = 40.0
"""Upper end of Gibbs integrals, in kT above the lowest energy: about e^−40 = 4e-18 lies beyond."""
