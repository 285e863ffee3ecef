"""The system on which simulations are tried hard."""

from dataclasses import replace

from cases.scene.scene import load_scene
from fpk.system.system import System


def with_stops(stiffness: float) -> System:
    """Return the system of ``stiff-stops``, for which (7) is exact, with stops of ``stiffness``."""
    system = load_scene("stiff-stops").system
    return replace(system, contacts=tuple(replace(c, stiffness=stiffness) for c in system.contacts))
