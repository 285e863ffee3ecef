"""Records of integrators: a contact kick, a random linear map, and how states are observed."""

from collections.abc import Callable
from dataclasses import dataclass

from fpk.system import System
from sim.flow import LinearMap


@dataclass(frozen=True)
class Scheme:
    """One integrator of Eq. (6): kick by the contact force g, then a random linear map.

    The kick is ``p_i -= h g_i (1 − w h² g_i'/m_i)`` with ``w = modified``; for ``kick_first``
    False it is added after the map, from the force before it. States are stored just before a
    step; observed is the state in the middle of the kick if ``symmetric`` (half the kick, and half
    that of the springs if ``springs_kicked``), corrected by the processor for ``w > 0``
    (see ``sim/schemes/exact_flow.py``). ``weak_order`` is the order in the step of stationary
    averages, contact forces being smooth enough; ``linear_map(system, h)`` is the rest of the step,
    without the kick of the springs if ``springs_kicked``.

    Damping terms act for h/2 before the kicks and, in reverse order, for h/2 after them, the state
    in the middle being observed: symmetric, of second order in the terms, which are small. Where
    the kick is not first they are of Euler's kind, by the forces from before the map.

    With ``small`` > 1 a step is a long one of so many small ones: trajectories that cannot touch
    a stop within it make it at once (``sim.substeps``).
    """

    name: str
    weak_order: int
    linear_map: Callable[[System, float], LinearMap]
    modified: float = 0.0
    kick_first: bool = True
    symmetric: bool = True
    springs_kicked: bool = False
    small: int = 1


SCHEMES: dict[str, Scheme] = {}


def register(scheme: Scheme) -> Scheme:
    """Add an integrator to the registry and return it; a name is taken once."""
    if scheme.name in SCHEMES:
        raise ValueError(f"scheme {scheme.name!r} is registered already")
    SCHEMES[scheme.name] = scheme
    return scheme
