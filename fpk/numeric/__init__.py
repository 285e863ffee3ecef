"""Arrays, piecewise polynomials, quadrature, Krylov spaces, compiling, resources of the machine."""
