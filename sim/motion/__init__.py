"""Motions of Eq. (6) in time, read step by step: first passage, transients, crossings, spectra."""
