"""Monte Carlo of averaged equations: energies as square-root processes, Eqs. (9), (17)."""
