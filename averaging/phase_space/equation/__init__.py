"""The FPK equation of the full system at given degrees: its expansion, equations and solution.

``frame`` has the system relative to the mass that meets the stops, ``basis`` the functions of its
displacement, ``degrees`` the Hermite polynomials in all else. ``chain`` and
``damping`` make the equations, and ``elimination`` solves them.
"""
