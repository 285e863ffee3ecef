"""Observables and limits of modal energies in time, of whatever solver: which modes they name."""

from averaging.time.start import EnergyStart
from fpk.errors import NotApplicable
from fpk.limit import Limit
from fpk.observable import Observable, observable_name

TOL = 1e-8
"""Error wanted where none is named."""


def observed_modes(observable: Observable) -> list[int]:
    """Return the modes whose energies are asked for, none for the sum of all.

    Raises ``NotApplicable`` for displacements and momenta beside energies.
    """
    rows = [c.row for c in observable if c.index is not None]
    if any(c.kind != "H" for c in observable) or len(observable) != max(len(rows), 1):
        name = observable_name(observable)
        raise NotApplicable(
            f"{name}: in time modal energies H1, H2, …, two of them, or their sum H; "
            "or one or two of q and p"
        )
    return rows


def limited_modes(limit: Limit, start: EnergyStart) -> dict[int, float]:
    """Return the limits of modes, none for that of the sum of all.

    Raises ``NotApplicable`` for limits of displacements, ``InvalidInput`` for a start at or beyond.
    """
    if limit.kind == "q":
        raise NotApplicable(f"{limit}: averaged modal energies know no displacement; use H, H1, …")
    limits = {int(name[1:]) - 1: a for name, a in limit.values.items() if name != "H"}
    start.require_below(limit)
    return limits
