"""The exact stationary solution (7), (22), where damping and noise are in proportion (8)."""

from dataclasses import dataclass

import numpy as np

from averaging.energy_process import damping_by_energy, energy_process, state_closed_form
from averaging.theory import EnergyTheory
from averaging.weyl import StateDensity
from fpk.numeric.arrays import ROUND_OFF, SMALLEST, Array
from fpk.numeric.errors import NotApplicable
from fpk.system.system import System


def compatibility(system: System) -> Array:
    """Return h(H) of the compatibility condition (8), ``2 c_ij = h b_ij`` with ``b = 2 f D fᵀ``.

    Coefficients in ascending powers of H, one for constant damping. The antisymmetric part of c
    does no work and does not enter, unless it depends on velocities. Raises ``NotApplicable``
    where no h meets the condition, or h is not positive at high energy.
    """
    D = system.noise_matrix
    if not np.any(D):
        raise NotApplicable("condition (8) needs noise, and there is none")
    matrices = damping_by_energy(system)
    if matrices is None:
        raise NotApplicable(
            "the compatibility condition (8) is not met: the damping depends on q or v beside H"
        )
    if not np.any(matrices):
        raise NotApplicable("nothing is damped: (8) holds with h = 0 only, no stationary density")
    h: Array = np.einsum("eij,ij->e", matrices, D) / np.sum(D * D)
    sizes = np.maximum(np.max(np.abs(matrices), axis=(1, 2)), SMALLEST)
    left = np.max(np.abs(matrices - h[:, None, None] * D), axis=(1, 2)) / sizes
    worst = float(left.max())
    h = np.asarray(np.trim_zeros(h, "b"), dtype=float)
    if not h.size or h[-1] <= 0 or worst > ROUND_OFF:
        best = ", ".join(f"{part:.4g}" for part in h) or "0"
        raise NotApplicable(
            "the compatibility condition (8), c_ij = h (f D fᵀ)_ij for all i, j, is not met: "
            f"even with the best h = {best}, an entry is off by {worst:.2g} of the largest damping"
        )
    return h


@dataclass(frozen=True)
class Exact(EnergyTheory):
    """Exact stationary density C exp(−∫h dH) of the full system, Eqs. (7), (22), (23).

    It exists where (8) holds; with constant damping h is a constant, and the normalisation the
    configuration integral over the contact masses; otherwise it is an integral over the shells. ::

        fpk.solve(fpk.load("fig3a").system, ["q2,p2"], methods=[Exact()])

    Upcrossings per unit time of levels by the second mass::

        system, levels = fpk.load("fig3a").system, np.array([0.0, 0.5])
        Exact().crossings(system, parse_observable("q2", 2), levels).values
    """

    method = "exact"
    solvers = (("closed-form", "exact", "(7)"),)
    colour = "#056c66"

    def exponential(self, system: System) -> bool:
        """Return whether h is a constant; raise ``NotApplicable`` where (8) does not hold."""
        h = compatibility(system)
        energy_process(system)
        return h.size == 1

    def state(self, system: System) -> tuple[StateDensity, dict[str, str | float | int]]:
        """Return u, which solves the full equation, and h; the residual is what is left of (8)."""
        h = compatibility(system)
        settings: dict[str, str | float | int] = {"equation": "(7), (22)", "h": float(h[0])}
        settings |= {f"h, H^{power}": x for power, x in enumerate(h[1:].tolist(), start=1)}
        constant, D = 0.5 * (system.damping + system.damping.T), h[0] * system.noise_matrix
        left = float(np.max(np.abs(constant - D)) / np.max(np.abs(D)))
        return state_closed_form(system, h, residual=None if h.size > 1 else left), settings


Exact.register()
