"""FPK equation of one energy: certified hp finite elements for the stationary state and in time."""
