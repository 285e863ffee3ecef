"""Two energies in time: the FPK operator, transients, relaxation rates and first passage."""
