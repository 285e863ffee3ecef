"""Shells of constant energy: reduced potential, rays, directions, density of states."""
