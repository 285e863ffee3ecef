"""Integrators, one file each; every module of this folder registers its own when it is imported.

An integrator is a contact kick and a random linear map, with the state that is observed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pkgutil import iter_modules

from fpk.system.system import System
from sim.step.flow import LinearMap


@dataclass(frozen=True)
class Scheme:
    """One integrator of Eq. (6): kick by the contact force g, then a random linear map.

    The kick is ``p_i -= h g_i (1 − w h² g_i'/m_i)`` with ``w = modified``; for ``kick_first``
    False it comes after the map, by the force before it. Where it is first, observed is the state
    in the middle of the kick, corrected by the processor for ``w > 0`` (see ``exact_flow``).
    ``weak_order`` is the order in h of stationary averages, contact forces being smooth enough;
    ``linear_map(system, h)`` the rest of the step, without the springs if they are kicked, too.

    Damping terms act for h/2 before the kicks and, in reverse order, for h/2 after them; where the
    kick is not first for h by Euler's rule. With ``small`` > 1 a step is a long one of so many
    small ones (``sim.sample.plan``).
    """

    name: str
    weak_order: int
    linear_map: Callable[[System, float], LinearMap]
    modified: float = 0.0
    kick_first: bool = True
    springs_kicked: bool = False
    small: int = 1


SCHEMES: dict[str, Scheme] = {}


def register(scheme: Scheme) -> Scheme:
    """Add an integrator to the registry and return it; a name is taken once."""
    if scheme.name in SCHEMES:
        raise ValueError(f"scheme {scheme.name!r} is registered already")
    SCHEMES[scheme.name] = scheme
    return scheme


for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
