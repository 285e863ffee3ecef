"""System to Density by sampling: Monte Carlo of the full Ito system (6), and of averaged energies.

``MonteCarlo`` is the method; importing this room registers its route. What is compiled, and Dask,
are imported by the first simulation.
"""

from sim.montecarlo import MonteCarlo

__all__ = ["MonteCarlo"]
