"""The FPK equation of the full system, solved in phase space without sampling.

``equation`` has the expansion and its solution at given degrees, ``refinement`` how degrees and
reference adapt to a tolerance; ``marginals`` and ``densities`` what follows from a
solution, ``dynamics`` crossings, spectra and relaxation rates, ``passage`` first passage of one
mass, by finite elements, and ``method`` the route.
"""
