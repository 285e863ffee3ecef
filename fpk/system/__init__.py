"""Systems of masses, springs, damping, noise and contacts; the processes of their energies."""
