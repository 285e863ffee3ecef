"""System to Density by sampling: Monte Carlo of the full Ito system (6)."""
