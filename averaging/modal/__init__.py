"""Modes of the chain without contacts, their averaged energies and internal resonances."""
