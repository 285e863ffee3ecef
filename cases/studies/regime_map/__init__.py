"""The map of regimes: which theory is nearer to the full system, over a grid of parameters."""
