"""Systems, diffusion processes, densities and the finite element solvers of their FPK equation.

The lowest room: it knows neither averaging, nor sampling, nor scenes. Conventions that hold in
every room: Ito equations ``dX = drift dt + noise_factor dB``, ``B`` standard Wiener processes;
``diffusion = noise_factor @ noise_factor.T``; the FPK operator is
``-d_i(s_i p) + ½ d_i d_j(b_ij p)``, the ½ staying in the equation; a noise intensity
``D`` means ``E[W(t) W(t+τ)] = 2 D δ(τ)``.
"""
