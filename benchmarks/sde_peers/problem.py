"""The system that every package steps, as plain numbers, and what its samples are judged by.

fig6's chain with equal c/D, so that p(q2) is known: dq = p dt,
dp = −(K q + g(q2) e2 + c p) dt + √(2 D) dW, Eq. (6) with unit masses (D: ``E[W W'] = 2 D δ``).
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.append(str(Path(__file__).resolve().parent.parent))

from accuracy import EDGES, exact_scene, probabilities

Array = NDArray[np.float64]
__all__ = ["EDGES", "Array", "Chain", "judged", "probabilities"]


@dataclass(frozen=True, eq=False)
class Chain:
    """Two unit masses: K (2, 2), c (2,), D (2,), stops of stiffness B at ±δ of the second."""

    K: Array
    c: Array
    D: Array
    B: float
    clearance: float

    @property
    def noise(self) -> Array:
        """√(2 D) (2,)."""
        return np.sqrt(2.0 * self.D)

    def force(self, q: Array) -> Array:
        """Return K q + g(q2) e2 of displacements (2, paths), Eq. (2) with the power 3/2."""
        force = self.K @ q
        overlap = np.maximum(np.abs(q[1]) - self.clearance, 0.0)
        force[1] += np.sign(q[1]) * self.B * overlap * np.sqrt(overlap)
        return force

    def start(self, paths: int, seed: int) -> Array:
        """Return states (4, paths), q = 0 and momenta of the temperature ΣD/Σc."""
        kT = self.D.sum() / self.c.sum()
        p = np.sqrt(kT) * np.random.default_rng(seed).standard_normal((2, paths))
        return np.vstack([np.zeros_like(p), p])


def judged() -> Chain:
    """Return the chain with equal c/D, whose p(q2) is exact."""
    system = exact_scene()
    stop = next(stop for stop in system.stops if stop.side == "right")
    damping, noise = np.diag(system.damping).copy(), np.diag(system.noise_matrix).copy()
    return Chain(system.stiffness_matrix, damping, noise, stop.stiffness, stop.clearance)
