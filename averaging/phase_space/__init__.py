"""The FPK equation of the full system, solved in phase space without sampling.

``equation`` has the expansion and its solution at given degrees, ``refinement`` how degrees and
reference adapt to a tolerance; ``marginals``, ``moments``, ``identities`` and ``crossings`` what
follows from a solution, ``resolvent`` and ``dynamics`` spectra and relaxation rates, and ``method``
the route.
"""
