"""Modal energies in time: transients, first passage and relaxation, Eqs. (17), (33)."""
