"""Which theory fits a system: compatibility (8), clearance against motion, frequencies."""

from dataclasses import dataclass

from fpk.clearance import StopClearance, stop_clearances
from fpk.linear import natural_frequencies
from fpk.system import System


@dataclass(frozen=True)
class Regime:
    """Facts of a system by which a theory applies to it or not.

    ``incompatible`` says why the compatibility condition (8) fails, None where it holds.
    """

    natural_frequencies: tuple[float, ...]
    incompatible: str | None
    stops: tuple[StopClearance, ...]

    @property
    def contacts_negligible(self) -> bool | None:
        """Whether every clearance exceeds twice the rms displacement, section 6.3."""
        known = [s.beyond_rule for s in self.stops]
        return None if None in known else all(known)


def regime_of(system: System, incompatible: str | None) -> Regime:
    """Return the regime of ``system``; ``incompatible`` is the refusal of the exact theory."""
    return Regime(
        natural_frequencies=tuple(float(w) for w in natural_frequencies(system)),
        incompatible=incompatible,
        stops=stop_clearances(system),
    )
