"""Simulated answers in time: curves, transients, first passage, rare failure, averaged energies."""
