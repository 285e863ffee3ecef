"""Quantities over a grid of parameters: the grid, its points on disk, and ``fpk sweep``."""
