"""What averaging makes of a system without its contacts: when to doubt an averaged answer."""

from dataclasses import dataclass

import numpy as np

from fpk.errors import NotApplicable
from fpk.linear import linear_covariance
from fpk.system import System


@dataclass(frozen=True)
class LinearPart:
    """The motion without contacts by the averaged theories, over the exact one.

    ``rms_ratio`` has by theory the least and the largest rms of a displacement or a velocity by the
    theory, over the exact rms. ``temperatures`` is the largest E P_m² of a mode over the least;
    ``damping_ratio`` the largest c*_mm/(2 ω_m): half the bandwidth of a mode over its frequency.
    """

    rms_ratio: dict[str, tuple[float, float]]
    temperatures: float
    damping_ratio: float


def linear_part(system: System) -> LinearPart:
    """Return what each averaged theory makes of ``system`` without its contacts.

    Energy averaging gives all modes one temperature, Σ D_ii/m_i / Σ c_ii/m_i; modal averaging gives
    each its own, (34), and no correlation. Contacts exchange energy between the modes: the
    averaging error of a system with contacts is mostly smaller. Raises ``NotApplicable`` where a
    mode is not damped or gets no energy, or the damping depends on the state.
    """
    exact, n = system.fact(linear_covariance), system.n
    T, omega, energies = exact.shapes, exact.omega, np.diag(exact.covariance)[system.n :]
    if not np.all(energies > exact.relative_error * np.max(energies)):
        raise NotApplicable("a mode gets no energy")
    noise, damping = (np.diag(T.T @ x @ T) for x in (system.noise_matrix, system.damping))
    states = np.block([[T / omega, 0.0 * T], [0.0 * T, T]])
    variance = np.sum((states @ exact.covariance) * states, axis=1)
    temperatures = {
        "nonintegrable": np.full(n, np.sum(noise) / np.sum(damping)),
        "integrable": noise / damping,
    }
    ratios = {
        theory: np.sqrt(states**2 @ np.tile(own, 2) / variance)
        for theory, own in temperatures.items()
    }
    return LinearPart(
        {theory: (float(r.min()), float(r.max())) for theory, r in ratios.items()},
        float(np.max(energies) / np.min(energies)),
        float(np.max(0.5 * damping / omega)),
    )
