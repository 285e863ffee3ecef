"""System to Density by theory: stochastic averaging, exact and Gaussian solutions.

``NonIntegrable`` averages the total energy, ``Integrable`` the energies of the modes; ``Exact`` and
``Linear`` solve the full system where its damping and noise, or the lack of contacts, allow it,
``PhaseSpace`` up to three masses with stops on one of them.
Each is loaded, and its routes registered, when it is first used.
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

_HOME = {
    "Exact": "averaging.theory",
    "Integrable": "averaging.integrable",
    "Linear": "averaging.gaussian",
    "NonIntegrable": "averaging.nonintegrable",
    "PhaseSpace": "averaging.phase_space.method",
}


def __getattr__(name: str) -> Any:
    """Load a method when it is first used."""
    if name not in _HOME:
        raise AttributeError(f"module 'averaging' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
