"""Solvers of the FPK equation of one and two energies, stationary and in time."""
