"""The FPK equation of the full system, solved in phase space without sampling.

``equation`` has the expansion at given degrees: the system relative to the mass that meets stops
(``frame``), functions of its displacement (``basis``), ``degrees`` in the other variables, the
equations (``chain``) and their ``elimination``. ``refinement`` adapts degrees and reference to a
tolerance; ``marginals`` and ``densities`` evaluate a solution, ``dynamics`` answers questions in
time by the resolvent. ``plane`` solves the equation of one mass by finite elements: its stationary
density, its density in time, its first passage.
"""
