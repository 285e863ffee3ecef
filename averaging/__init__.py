"""System to Density by theory: stochastic averaging, exact and Gaussian solutions."""
