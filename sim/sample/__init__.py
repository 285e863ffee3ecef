"""Sampling: settings, ensembles, histograms, checkpoints, and the report of a simulation."""
