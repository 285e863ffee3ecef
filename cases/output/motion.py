"""How a system moves: its natural modes with their damping, and rms displacements."""

from contextlib import suppress
from typing import Any

import numpy as np

from cases.comparison.routes import method_for
from fpk.errors import NotApplicable, NotCertified
from fpk.linear import natural_modes
from fpk.observable import Coordinate
from fpk.system import System

MODES_SHOWN = 50
"""Modes whose damping and shape are given: matrices of more are for a computer."""
MASSES, LINEAR_MASSES = 3, 50
"""Masses of a chain with one contact mass, and of one without contacts, up to which the rms of
every displacement is given: a second. In longer chains, and where the damping depends on the
state beside a contact, that of the one in contact."""
ROUTES = ("linear", "exact", "nonintegrable")
"""Routes to the rms of a displacement, those exact for (6) before; the first that applies."""


def modes_record(system: System) -> list[dict[str, Any]]:
    """Return frequency, damping ratio and shape of the natural modes, the slowest first.

    The ratio is c*_mm/(2 ω_m), c* = Tᵀ c T with Tᵀ M T = 1: of the constant damping, without what
    couples the modes (``coupled`` is the largest |c*_ml| beside it over √(c*_mm c*_ll)). The
    largest component of a shape is 1.
    """
    shapes, omega = natural_modes(system)
    c = shapes.T @ system.damping @ shapes
    own = np.diag(c)
    with np.errstate(divide="ignore", invalid="ignore"):
        coupling = np.nan_to_num(np.abs(c) / np.sqrt(np.outer(own, own)), posinf=0.0)
    np.fill_diagonal(coupling, 0.0)
    largest = shapes[np.argmax(np.abs(shapes), axis=0), np.arange(system.n)]
    return [
        {
            "frequency": omega[m],
            "damping_ratio": own[m] / (2.0 * omega[m]),
            "coupled": np.max(coupling[m]),
            "shape": shapes[:, m] / largest[m],
        }
        for m in range(min(system.n, MODES_SHOWN))
    ]


def rms_record(system: System) -> list[dict[str, Any]]:
    """Return √E q_i² with its numerical error and its route; one of an averaged theory averages.

    Empty where no route of ``ROUTES`` applies, and where more than one mass has stops: integrals
    that take seconds. A number that is known badly is given with its large error.
    """
    touching = system.contact_masses
    if len(touching) > 1:
        return []
    easy = not touching or not system.damping_terms
    every = easy and system.n <= (MASSES if touching else LINEAR_MASSES)
    wanted = [(Coordinate("q", i),) for i in (range(system.n) if every else touching)]
    for name in ROUTES:
        with suppress(NotApplicable, NotCertified):
            method = method_for(name)
            result = method.solve(system, wanted)
            return [
                {
                    "of": density.name,
                    **vars(density.rms()),
                    "route": method.route.label,
                    "solves": method.route.solves,
                }
                for density in result.densities
            ]
    return []
