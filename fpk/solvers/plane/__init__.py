"""Stationary FPK equation of two energies: tensor hp elements, statically condensed."""
