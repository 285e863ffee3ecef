"""Limits and starts of averaged energies, as their simulation takes them."""

import numpy as np

from cases.scene.expect import Theory
from fpk.arrays import Array
from fpk.errors import NotApplicable
from fpk.limit import Limit
from fpk.linear import modal_energies
from fpk.start import Start
from fpk.system import System
from sim.averaged.passage import EnergyLimits, Starts, from_energies
from sim.averaged.square_root import SquareRootForm


def limits_of(theory: Theory, form: SquareRootForm, limit: Limit) -> EnergyLimits:
    """Return the limit as one of X; raise ``NotApplicable`` where the theory does not know it."""
    line, d = theory == "nonintegrable", form.scales.size
    if limit.kind == "q" or (limit.kind == "modal" and line):
        known = "H" if line else "H and of modal energies"
        raise NotApplicable(f"{limit}: this theory knows limits of {known} only")
    if limit.kind == "modal":
        named = sorted((int(name[1:]) - 1, value) for name, value in limit.values.items())
        values = np.array([value for _, value in named])
        return EnergyLimits(np.eye(d)[[m for m, _ in named]], values, str(limit))
    values = np.array([limit.value])
    values = from_energies(form, values[None])[0] if line else values
    return EnergyLimits(np.ones((1, d)), values, str(limit))


def starts_of(theory: Theory, system: System, start: Start) -> Starts:
    """Return what draws the energies (paths, d) at time 0, but for starts under other noise.

    H of the integrable theory is spread evenly over H1 + H2 + … = H, as on its shell.
    Raises ``NotApplicable`` for modal energies where contact leaves H open.
    """
    line, n, values = theory == "nonintegrable", system.n, start.values
    if start.kind == "energy" and not line:

        def spread(paths: int, stream: np.random.Generator) -> Array:
            share = stream.exponential(size=(paths, n))
            return np.asarray(values["H"] * share / share.sum(axis=1, keepdims=True))

        return spread
    if start.kind == "energy":
        energies = np.array([values["H"]])
    elif start.kind == "modal":
        if line and system.stops:
            raise NotApplicable(f"{start}: modal energies leave H open where there is contact")
        energies = np.array([values[f"H{m + 1}"] for m in range(n)])
    else:
        q, p = start.state(n)
        total = np.array([float(system.hamiltonian(q, p))])
        energies = total if line else modal_energies(system, q, p)
    fixed = np.atleast_1d(energies.sum()) if line else energies
    return lambda paths, stream: np.tile(fixed, (paths, 1))
