"""Arrays, functions by polynomials, quadrature, compiling, and what the machine offers."""
