"""FPK equation of two energies: tensor hp finite elements, for the stationary state and in time."""
