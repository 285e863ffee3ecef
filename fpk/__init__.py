"""Densities of randomly excited vibro-impact systems: the face, and the lowest room.

``System``, ``Contact`` and ``DampingTerm`` describe Eq. (1); ``load`` reads a scene; ``solve``
returns densities with their errors and certificates; ``compare`` says what separates them;
``sweep`` varies numbers of a system, ``plot`` draws a density::

    import fpk
    stop = fpk.Contact(mass=2, side="both", stiffness=10.0, clearance=0.5)
    system = fpk.System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02], contacts=(stop,))
    answers = fpk.solve(system, ["q2", "H"], methods=["nonintegrable/fem"])
    answers["q2"](0.3)

Every name is loaded when it is first used; functions come from the room ``cases``, the one place
where this room points up. Conventions in every room: Ito equations ``dX = drift dt + noise_factor
dB``, ``B`` standard Wiener processes; ``diffusion = noise_factor @ noise_factor.T``; the FPK
operator is ``-d_i(s_i p) + ½ d_i d_j(b_ij p)``, the ½ staying in the equation; a noise intensity
``D`` means ``E[W(t) W(t+τ)] = 2 D δ(τ)``. Masses count from 1.
"""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cases.api import compare as compare
    from cases.api import load as load
    from cases.api import plot as plot
    from cases.api import solve as solve
    from cases.study.sweep.sweep import sweep as sweep
    from fpk.answer.density import Density as Density
    from fpk.numeric.errors import InvalidInput as InvalidInput
    from fpk.numeric.errors import NotApplicable as NotApplicable
    from fpk.numeric.errors import NotCertified as NotCertified
    from fpk.system.contact import Contact as Contact
    from fpk.system.damping import DampingTerm as DampingTerm
    from fpk.system.system import System as System

_MODULE_OF = {
    "Contact": "fpk.system.contact",
    "DampingTerm": "fpk.system.damping",
    "Density": "fpk.answer.density",
    **dict.fromkeys(("InvalidInput", "NotApplicable", "NotCertified"), "fpk.numeric.errors"),
    "System": "fpk.system.system",
    **dict.fromkeys(("compare", "load", "plot", "solve"), "cases.api"),
    "sweep": "cases.study.sweep.sweep",
}
__all__ = [*_MODULE_OF]


def __getattr__(name: str) -> Any:
    """Import and return the public object ``name``, and store it in this module for later uses.

    Raises ``AttributeError`` if ``name`` is not in ``__all__``, and ``ImportError`` for a name from
    ``cases`` if one of the packages of vibro-fpk is missing, or a file or folder of the user hides
    it.
    """
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'fpk' has no attribute {name!r}; it has {', '.join(__all__)}")
    beside = Path(__file__).resolve().parent.parent
    for room in ("averaging", "sim", "cases") if _MODULE_OF[name].startswith("cases.") else ():
        spec = find_spec(room)
        if spec is None:
            raise ImportError(f"the package {room} of vibro-fpk is missing: install it again")
        # A package's origin is its __init__.py; a folder without one has its location alone.
        places = [spec.origin or "", *(spec.submodule_search_locations or ())]
        where = next(place for place in places if place)
        if beside not in Path(where).resolve().parents:
            raise ImportError(f"{where} hides the package {room} of vibro-fpk: rename it")
    value = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names and all names loaded so far."""
    return sorted({*globals(), *__all__})
