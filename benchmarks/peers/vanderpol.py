"""W4: the scene vanderpol, two modal energies that damp one another unequally: no closed form.

s_i = d_i − (γ_i + Σ_j g_ij H_j) H_i, b_ii = 2 d_i H_i, the averaged equations (17) with the damping
terms of the scene. As g is not symmetric probability circulates. What answers are judged by is a
solution by this program's elements of degree 20 that expand p itself, with no weight, and estimates
its own error as 1e-12. NGSolve at p = 16 shares no code with it: that row shows how far the two are
apart. Below 1e-12 an L1 of W4 says nothing.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from averaging.modal.analysis import modal_analysis
from cases.scene.scene import load_scene
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.plane.solution import PlaneSolution
from fpk.solvers.plane.stationary import solve_by_elements
from fpk.solvers.plane.weight import flux_free_weight
from fpk.system.process import Process
from fpk.system.system import System

Array = NDArray[np.float64]

TRUTH = (1e-11, 20)
"""Tolerance and degree of the solution that answers are judged by."""


@lru_cache
def _shipped(scene: str) -> System:
    return load_scene(scene).system


def afresh(scene: str) -> System:
    """Return the system of a shipped scene, which remembers nothing of an earlier solve."""
    return replace(_shipped(scene))


@dataclass(frozen=True)
class Averaged:
    """Two modal energies of a scene whose damping is quadratic in its coordinates."""

    name: str
    scene: str

    dimension = 2
    contact_energies = ()

    @property
    def process(self) -> Process:
        """The averaged modal energies, from the system on, nothing remembered."""
        return modal_analysis(afresh(self.scene)).process()

    @property
    def temperature(self) -> Array:
        """Lengths in the ratio in which p extends along the axes, found by hand: boxes go by it."""
        return np.array([0.09, 0.225])

    @cached_property
    def rates(self) -> tuple[Array, Array, Array]:
        """d_i (2,), γ_i (2,) and g_ij (2, 2)."""
        modes = modal_analysis(afresh(self.scene))
        parts = modes.averaged.factors, modes.averaged.values
        by_factor = {int(f): np.diag(v) for (f,), v in zip(*parts, strict=True)}
        return modes.noise, by_factor[0], np.stack([by_factor[1], by_factor[2]], axis=1)

    def written(self, x, y, sigmoid):
        """Return (s_1, s_2), (b_11, b_22), Σ_j ∂b_ij/∂H_j and no b_12, of arrays or symbols."""
        noise, constant, linear = (rates.tolist() for rates in self.rates)
        energies = (x, y)
        drift = tuple(
            d - (c + g[0] * x + g[1] * y) * H
            for d, c, g, H in zip(noise, constant, linear, energies, strict=True)
        )
        diffusion = tuple(2.0 * d * H for d, H in zip(noise, energies, strict=True))
        return drift, diffusion, tuple(2.0 * d for d in noise), None

    def coefficients(self, points: Array) -> tuple[Array, Array, Array]:
        """Return s_i, b_ii and Σ_j ∂b_ij/∂H_j at points (2, ...), each of that shape."""
        s, b, divergence, _ = self.written(*points, None)
        constant = np.reshape(divergence, (2, *[1] * (points.ndim - 1)))
        return np.array(s), np.array(b), np.broadcast_to(constant, points.shape)

    def cross(self, points: Array) -> None:
        """No b_12."""

    @cached_property
    def truth(self) -> PlaneSolution:
        """The solution that answers are judged by; solved once, in nobody's time."""
        tol, degree = TRUTH
        weight = flux_free_weight(self.process)
        return solve_by_elements(self.process, weight, tol=tol, degree=degree)

    def exact(self, points: Array) -> Array:
        """p(H1, H2) at points (2, ...), 0 where less than 1e-12 of the probability lies."""
        return self.truth.density(points[0], points[1])

    def tail(self, ends: tuple[float, ...]) -> float:
        """Return the probability outside the box, by Gauss points between the truth's panels."""
        rules = []
        for nodes, end in zip(self.truth.panels, ends, strict=True):
            cut = np.unique([*nodes[nodes < end], min(end, nodes[-1])])
            rules.append([a.ravel() for a in panel_rule(cut, 24)])
        (x, wx), (y, wy) = rules
        return float(1.0 - wx @ self.truth.density(x[:, None], y) @ wy)
