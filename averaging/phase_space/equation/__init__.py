"""The FPK equation of the full system at given degrees: its expansion, equations and solution.

``frame`` has the system relative to the mass that meets the stops, ``panels`` and ``basis`` the
functions of its displacement, ``degrees`` the Hermite polynomials in all else. ``terms`` are blocks
of the matrix, ``equations`` and ``damping`` make them, ``chain`` has them in stages, and
``elimination`` solves it.
"""
