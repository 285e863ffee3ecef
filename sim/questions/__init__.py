"""What is asked of a simulation: motion in time, first passage, rare failure, averaged energies."""
