"""The stationary FPK equation of the full system, solved in phase space without sampling.

``frame`` has the equations relative to the mass that meets the stops, ``panels`` the functions of
its displacement, ``degrees`` and ``elimination`` the Hermite expansion in all else and its
solution, ``marginals`` the densities of it, ``refinement`` how degrees and reference adapt, and
``method`` the route. ``crossings`` has rates of crossing, ``resolvent`` what the operator does off
its stationary state, and ``dynamics`` the answers about time, to a tolerance.
"""
