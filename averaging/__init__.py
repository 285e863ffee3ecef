"""System to Density by theory: stochastic averaging, exact and Gaussian solutions.

``NonIntegrable`` averages the total energy, ``Integrable`` the energies of the modes. ``Exact``,
``Linear`` and ``PhaseSpace`` solve the FPK equation of the full system: ``Exact`` if damping and
noise meet condition (8), ``Linear`` if there are no contacts, ``PhaseSpace`` for up to three masses
with stops on one of them. A method is imported, and its routes registered, at its first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from averaging.gaussian import Linear
    from averaging.integrable import Integrable
    from averaging.nonintegrable import NonIntegrable
    from averaging.phase_space.method import PhaseSpace
    from averaging.theory import Exact

__all__ = ["Exact", "Integrable", "Linear", "NonIntegrable", "PhaseSpace"]

_HOME_OF = {
    "Exact": "averaging.theory",
    "Integrable": "averaging.integrable",
    "Linear": "averaging.gaussian",
    "NonIntegrable": "averaging.nonintegrable",
    "PhaseSpace": "averaging.phase_space.method",
}


def __getattr__(name: str) -> Any:
    """Import and return the method's class ``name``; raise ``AttributeError`` for other names."""
    if name not in _HOME_OF:
        raise AttributeError(f"module 'averaging' has no attribute {name!r}")
    return getattr(import_module(_HOME_OF[name]), name)
