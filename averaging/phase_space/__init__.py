"""The stationary FPK equation of the full system, solved in phase space without sampling.

``frame`` has the equations relative to the mass that meets the stops, ``panels`` and ``basis`` the
functions of its displacement, ``degrees`` and ``equations`` the Hermite expansion in all else,
``elimination`` its solution, ``marginals`` the densities of it, ``refinement`` how degrees and
reference adapt, ``resolvent`` and ``dynamics`` what moves in time, and ``method`` the route.
"""
