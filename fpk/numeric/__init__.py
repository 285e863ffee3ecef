"""Arrays, piecewise polynomials, quadrature, compiling, and the resources of the machine."""
