"""Where a motion begins: at rest, at energies, at a state, or stationary under other noise."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fpk.answer.observable import number_text, parse_numbers
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput
from fpk.system.escape import escape
from fpk.system.system import System


@dataclass(frozen=True)
class Start:
    """The state at time 0.

    ``values`` holds what is given by name: of ``kind`` "state" displacements q1.. and momenta p1..
    (those left out are 0, so that no name at all is rest), of "energy" H, of "modal" all modal
    energies H1.., of "noise" the factor ``noise`` on D under which the state is stationary at 0.
    """

    kind: str = "state"
    values: Mapping[str, float] = field(default_factory=dict)

    @property
    def rest(self) -> bool:
        """Whether nothing moves or is stretched, as of what is stationary without noise."""
        return not any(self.values.values())

    def state(self, n: int) -> tuple[Array, Array]:
        """Return q and p (n,) each, of the kind "state"."""
        q, p = (np.array([self.values.get(f"{k}{i + 1}", 0.0) for i in range(n)]) for k in "qp")
        return q, p

    def __str__(self) -> str:
        """Return the name that a user writes."""
        return ",".join(f"{k}={number_text(v)}" for k, v in self.values.items()) or "rest"


REST = Start()


def parse_start(text: str, system: System) -> Start:
    """Return the start that ``text`` names in ``system``.

    At rest, at an energy, stationary under half the noise, at a state::

        parse_start("rest", system), parse_start("H=0.3", system), parse_start("noise=0.5", system)
        parse_start("q1=0.2,p1=0.1", system)

    Raises ``InvalidInput`` for an unknown name, a mixture of kinds, a number that is not finite, an
    energy or a factor below 0, modal energies that are not all there, or a stationary state where
    the motion escapes.
    """
    if text.strip() == "rest":
        return REST
    q, p, modal = ([f"{kind}{i + 1}" for i in range(system.n)] for kind in "qpH")
    kinds = ("state", q + p, 1), ("energy", ["H"], 1), ("modal", modal, system.n)
    kind, values = parse_numbers(
        "start",
        text,
        (*kinds, ("noise", ["noise"], 1)),
        "use rest, H=0.3, modal energies H1=0.1,H2=0.2, a state q1=0.2,p1=0.1,.. (what is left out "
        "is 0), or noise=0.5 for the stationary state under that multiple of the noise intensity",
    )
    if kind == "noise" and values["noise"] > 0.0 and (reason := system.fact(escape)):
        raise InvalidInput("start", text, f"there is no stationary state: {reason}")
    if kind != "state" and min(values.values()) < 0.0:
        raise InvalidInput("start", text, "must not be negative")
    return Start(kind, values)
