"""How long a system remembers: of constant damping from its drift, of terms from their powers."""

from math import exp, inf, isfinite, lgamma, sqrt
from typing import Any

import numpy as np
import scipy  # its parts are loaded at their first use: scipy.optimize takes long to import

from fpk.arrays import ROUND_OFF, Array
from fpk.damping import gaussian_moment
from fpk.equivalent import damping_balance, equivalent_temperature
from fpk.linear import decay_time, natural_modes
from fpk.system import System


def relaxation_time(system: System) -> float:
    """Return the longest decay time of the motion without contact; inf if some never decays.

    With damping terms modes are taken for Gaussian at temperatures θ_m that balance,
    ``dθ_m/dt = S_m − P_m(θ)``: S_m the power of the noise, P_m that of all damping; an eigenvalue
    of ∂P/∂θ there is the decay rate of an energy. One temperature for all modes gives a second
    estimate, 2n/P'(θ), and the longer one counts. Rare passages between coexisting states take
    longer than this: it is for ``burn_in`` and ``time`` to allow for them.
    """
    if not system.damping_terms:
        return decay_time(system)
    equivalent_temperature(system)  # raises where damping and noise do not balance
    slope = system.fact(damping_balance).slope
    times = [2.0 * system.n / slope] if slope > 0 else []
    if (balance := modal_temperatures(system)).size:
        slowest = float(natural_modes(system)[1][0])
        # ∂P/∂θ by central differences: a polynomial of low degree, so that 1e-4 costs no digit.
        change = [
            modal_powers(system, balance + h) - modal_powers(system, balance - h)
            for h in np.diag(1e-4 * balance)
        ]
        rates = np.linalg.eigvals(np.transpose(change) / (2e-4 * balance)).real
        if np.all(rates > 0):
            times += [_amplitude_time(float(rate), slowest) for rate in rates]
    return max((time for time in times if isfinite(time)), default=inf)


def modal_temperatures(system: System) -> Array:
    """Return the temperatures θ (n,) of ``relaxation_time`` at which modes balance; none: empty."""
    shapes, _ = natural_modes(system)
    noise = np.einsum("im,ij,jm->m", shapes, system.noise_matrix, shapes)
    start = np.full(system.n, equivalent_temperature(system))
    root: Any = scipy.optimize.root  # the stubs want a function of a fixed shape
    balance: Any = root(lambda theta: noise - modal_powers(system, theta), start, method="hybr")
    found = balance.success and np.all(balance.x > 0)
    return np.asarray(balance.x) if found else np.zeros(0)


def modal_powers(system: System, temperatures: Array) -> Array:
    """Return E P_m (Tᵀ c M⁻¹ p)_m, modes being independent Gaussians of ``temperatures`` (n,).

    H^e of a term stands for E H^e of the Gibbs state of the same mean energy.
    """
    n, (shapes, omega) = system.n, natural_modes(system)
    displacements = (shapes * (temperatures / omega**2)) @ shapes.T
    velocities = (shapes * temperatures) @ shapes.T
    force = system.damping @ velocities  # E (c v)_i v_r
    power = np.einsum("im,ir,r,rm->m", shapes, force, system.mass, shapes)
    mean = float(np.mean(np.abs(temperatures)))
    for term in system.damping_terms:
        level = mean**term.energy * exp(lgamma(n + term.energy) - lgamma(n))
        q = gaussian_moment(displacements, term.powers("q", n))
        for r in range(n):
            v = list(term.powers("v", n))
            v[term.column] += 1
            v[r] += 1
            moment = term.coefficient * level * q * gaussian_moment(velocities, tuple(v))
            power = power + shapes[term.row] * moment * system.mass[r] * shapes[r]
    return np.asarray(power)


def undamped_mode(system: System) -> bool:
    """Return whether neither the constant damping nor any term acts on some mode.

    Where terms act, whether they suffice is left to ``equivalent_temperature``, to lost
    trajectories and to the moment identities.
    """
    shapes, omega = natural_modes(system)
    constant = np.abs(np.einsum("im,ij,jm->m", shapes, system.damping, shapes))
    reached = constant > ROUND_OFF * omega[-1]
    size = np.abs(shapes) * np.sqrt(system.mass)[:, None]  # at most 1
    for term in system.damping_terms:
        reached |= size[term.row] * size[term.column] > ROUND_OFF
    return not bool(np.all(reached))


def _amplitude_time(rate: float, omega: float) -> float:
    """Decay time of ``x'' + rate x' + ω² x = 0``; creeping has (rate/2 + √…)/ω²."""
    half = 0.5 * rate
    return (half + sqrt(half * half - omega * omega)) / omega**2 if half > omega else 1.0 / half
