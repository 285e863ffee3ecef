"""The equations that every peer solves: coefficients for the peers, densities to judge them.

Peers get the coefficients by a quadrature of the level integrals in NumPy, which takes 16 Gauss
points on each smooth part of the reduced potential and estimates no error. They are judged by the
closed form (29) of this program. W1 is fig6 with B = 10 and δ = 0.5, the energy p(H); W3 and W4 are
two coupled energies, see ``coupled.py`` and ``vanderpol.py``; one more is W1 with stiffer stops.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from coupled import Mixture
from numpy.typing import NDArray
from vanderpol import Averaged

from averaging.energy_process import closed_form_density
from averaging.weyl import Solution
from fpk.numeric.quadrature import gauss_legendre, panel_rule
from fpk.system.contact import Contact
from fpk.system.system import System

Array = NDArray[np.float64]

DAMPING, NOISE = 0.12, 0.03
"""Σ c_ii/m_i and Σ D_ii/m_i of fig6."""
ALPHA = DAMPING / NOISE
SPRING = 0.5
"""k1 k2/(k1 + k2), what mass 2 feels with mass 1 integrated out."""
POINTS = 16
MASS = (1.0, 1.0)
CLEARANCE = 0.5
CONTACT_ENERGY = 0.5 * SPRING * CLEARANCE**2


@dataclass(frozen=True)
class Line:
    """One energy: fig6 with stops of that stiffness on both sides of mass 2."""

    name: str
    stiffness: float

    dimension = 1

    @property
    def system(self) -> System:
        """The system, built afresh at each call: nothing is remembered."""
        stop = Contact(2, "both", self.stiffness, CLEARANCE)
        return System(MASS, (1.0, 1.0), (0.08, 0.04), (0.01, 0.02), contacts=(stop,))

    @property
    def contact_energies(self) -> tuple[float, ...]:
        """½ k δ²."""
        return (CONTACT_ENERGY,)

    def level_integrals(self, energy: Array) -> tuple[Array, Array, Array]:
        """Return T', T and Φ of (25), (28) up to one constant: ∫(H − V)^ν dq₂ over half the well.

        ν = −½, ½ and 3/2. As far as the stop V is a parabola, and q = √(2H/k) sin φ makes the
        integrands powers of cos φ.
        """
        width = np.sqrt(2.0 / SPRING)
        free = energy <= CONTACT_ENERGY
        result = tuple(np.pi * width * c * energy**k for c, k in ((0.25, 0), (0.25, 1), (0.125, 2)))
        if free.all():
            return result  # type: ignore[return-value]
        H = energy[~free]
        over = H - CONTACT_ENERGY
        # The angle by its tangent: as an arcsine it loses half its digits where contact begins.
        before = _parabola(H, np.arctan2(CLEARANCE, np.sqrt(2.0 * over / SPRING)))
        beyond = _hertz(over, self.stiffness)
        for whole, a, b in zip(result, before, beyond, strict=True):
            whole[~free] = width * a + b
        return result  # type: ignore[return-value]

    def coefficients(self, energy: Array) -> tuple[Array, Array, Array]:
        """Return s, b and b' of (28) with its sign corrected, at energies > 0 of any shape."""
        flat = np.ravel(energy)
        slope, states, volume = self.level_integrals(flat)
        tau = volume / states
        tau_slope = 1.0 - tau * slope / states
        found = NOISE - DAMPING * tau, 2.0 * NOISE * tau, 2.0 * NOISE * tau_slope
        return tuple(part.reshape(np.shape(energy)) for part in found)  # type: ignore[return-value]

    @cached_property
    def closed_form(self) -> Solution:
        """The closed form (29)."""
        system = self.system
        return closed_form_density(system)

    def exact(self, points: Array) -> Array:
        """p(H) of (29) at points (1, ...)."""
        return self.closed_form.density(points[0])

    def tail(self, ends: tuple[float, ...]) -> float:
        """Return the probability beyond ``ends``."""
        nodes = self.closed_form.nodes
        beyond = np.unique([ends[0], *nodes[nodes > ends[0]], max(ends[0], nodes[-1])])
        x, w = panel_rule(beyond, 24)
        return float(np.sum(w * self.closed_form.density(x))) if beyond.size > 1 else 0.0


Problem = Line | Mixture | Averaged
PROBLEMS: dict[str, Problem] = {
    p.name: p
    for p in (
        Line("W1", 10.0),
        Line("W1, B = 1e4", 1e4),
        Mixture("W3"),
        Averaged("W4", "vanderpol"),
    )
}


def _parabola(top: Array, length: Array) -> tuple[Array, Array, Array]:
    """Return the integrals over φ from 0 to ``length``, of unit width."""
    t, w = gauss_legendre(POINTS)
    square = np.cos(0.5 * length[:, None] * (1.0 + t)) ** 2
    half = 0.5 * length
    return half, half * top * (square @ w), half * top**2 * (square**2 @ w) * (2.0 / 3.0)


def _hertz(over: Array, stiffness: float) -> tuple[Array, Array, Array]:
    """Return the integrals from the stop to the turning point, ``over`` = H − H_c > 0.

    With the overlap X sin²θ, X the largest, H − V is X cos²θ times a factor that is smooth in θ.
    """
    slope, power = SPRING * CLEARANCE, 0.4 * stiffness
    X = np.minimum(over / slope, (over / power) ** 0.4)
    for _ in range(12):  # Newton from above on a convex function: at worst 6 are needed here
        root = np.sqrt(X)
        excess = (slope + 0.5 * SPRING * X + power * X * root) * X - over
        X = X - excess / (slope + SPRING * X + 2.5 * power * X * root)
    t, w = gauss_legendre(POINTS)
    theta = 0.25 * np.pi * (1.0 + t)
    s, c, w = np.sin(theta), np.cos(theta), 0.25 * np.pi * w
    share = (1.0 + s + s**2 + s**3 + s**4) / (1.0 + s)
    factor = slope + 0.5 * SPRING * X[:, None] * (1.0 + s**2)
    factor += (power * X**1.5)[:, None] * share
    root = np.sqrt(factor)
    slope_sum = np.sqrt(X) * ((1.0 / root) @ (w * s))
    states = 2.0 * X**1.5 * (root @ (w * s * c**2))
    volume = (4.0 / 3.0) * X**2.5 * ((root * factor) @ (w * s * c**4))
    return slope_sum, states, volume
