"""Simulated answers in time: crossings, spectra, transients, first passage, rare failure.

``averaged`` simulates the energies of an averaged equation in place of the full system.
"""
