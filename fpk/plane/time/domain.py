"""Domains of two energies in the coordinates of a rectangle, on which elements are tensors.

Each is a smooth map from coordinates y of the rectangle, both counted from 0, to the energies, with
its inverse, |∂H/∂y|, and the coefficients F and b of ∫ (F u − ½ b ∇u)·∇v dH in y: with G = ∂y/∂H
and ∇_H u = Gᵀ ∇_y u they are G F and G b Gᵀ, the axes of energies last.
"""

from dataclasses import dataclass

import numpy as np

from fpk.arrays import Array


@dataclass(frozen=True)
class Rectangle:
    """y = (H1, H2)."""

    def energies(self, first: Array, second: Array) -> tuple[Array, Array]:
        """Return the coordinates themselves."""
        H1, H2 = np.broadcast_arrays(first, second)
        return H1, H2

    def coordinates(self, H1: Array, H2: Array) -> tuple[Array, Array]:
        """Return the energies themselves."""
        return self.energies(H1, H2)

    def jacobian(self, first: Array, second: Array) -> Array:
        """Return 1."""
        return np.ones(np.broadcast_shapes(first.shape, second.shape))

    def pulled_back(self, y: tuple[Array, Array], F: Array, b: Array) -> tuple[Array, Array]:
        """Return F and b."""
        return F, b


@dataclass(frozen=True)
class Triangle:
    """y = (H, H1/H) with H = H1 + H2: collapsed coordinates of H < H_f.

    Where H = 0 the map is singular and the weak form is not: b ~ H, so that ∫ ½ b ∇u·∇u dH of a u
    that depends on the share H1/H alone is finite.
    """

    def energies(self, first: Array, second: Array) -> tuple[Array, Array]:
        """Return H x and H (1 − x)."""
        return np.asarray(first * second), np.asarray(first * (1.0 - second))

    def coordinates(self, H1: Array, H2: Array) -> tuple[Array, Array]:
        """Return H and the share of H1, ½ where H = 0: there no function of energies knows it."""
        H1, H2 = np.broadcast_arrays(H1, H2)
        H = H1 + H2
        return H, np.divide(H1, H, out=np.full(H.shape, 0.5), where=H > 0.0)

    def jacobian(self, first: Array, second: Array) -> Array:
        """Return H."""
        return np.asarray(np.broadcast_arrays(first, second)[0])

    def pulled_back(self, y: tuple[Array, Array], F: Array, b: Array) -> tuple[Array, Array]:
        """Return both with G = ((1, 1), ((1 − x)/H, −x/H))."""
        H, x = np.broadcast_arrays(*y)
        G = np.stack([np.ones_like(H), np.ones_like(H), (1.0 - x) / H, -x / H], axis=-1)
        G = G.reshape(*H.shape, 2, 2)
        return np.einsum("...ij,...j->...i", G, F), G @ b @ np.swapaxes(G, -1, -2)


Domain = Rectangle | Triangle
