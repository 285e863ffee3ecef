"""Claims of a scene's source about its figure, read from the table ``[expect]``."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import ge, gt, le, lt
from typing import Any, Literal

from cases.scene.errors import BadInput, refused
from fpk.observable import Observable, observable_name

Theory = Literal["nonintegrable", "integrable"]
Direction = Literal["larger", "smaller"]


RELATIONS: dict[str, tuple[str, Callable[[float, float], bool]]] = {
    "above": (">", gt),
    "below": ("<", lt),
    "at_least": ("≥", ge),
    "at_most": ("≤", le),
}
"""How a claim gives a range of the varied number, with the sign of each."""


@dataclass(frozen=True)
class Range:
    """Values of the varied number in a ``relation`` of ``RELATIONS`` to ``limit``."""

    relation: str
    limit: float

    @property
    def words(self) -> str:
        """The range as an inequality without its left side."""
        return f"{RELATIONS[self.relation][0]} {self.limit:g}"

    def __contains__(self, value: float) -> bool:
        """Return whether ``value`` lies in the range."""
        return RELATIONS[self.relation][1](value, self.limit)


@dataclass(frozen=True)
class Expect:
    """The claims of one figure; a claim that is not made is None.

    ``of`` is the density that they are about. ``better``: the first theory is nearer to the full
    system than the second. ``acceptable``: theories whose L1 distance to the full system is small.
    ``clearance_rule``: the integrable theory is acceptable where every clearance exceeds this many
    rms displacements.
    """

    of: Observable
    non_gaussian: Range | None = None
    almost_gaussian: Range | None = None
    nonintegrable_better_with: Direction | None = None
    better: tuple[Theory, Theory] | None = None
    acceptable: tuple[Theory, ...] = ()
    clearance_rule: float | None = None


def expect_of(
    table: Mapping[str, Any] | None,
    observables: Sequence[Observable],
    label: str,
    *,
    curves: int,
) -> Expect | None:
    """Return the claims of the table; raise ``BadInput`` for one that the scene cannot test.

    ``curves`` is the number of curves in the scene.
    """
    if table is None:
        return None
    by_name = {observable_name(o): o for o in observables}
    given = table.get("of", next(iter(by_name)))
    name = ",".join(part.strip() for part in given.split(","))
    if name not in by_name:
        remedy = f"is not observed here; use {', '.join(by_name)}"
        raise refused(label, "expect.of", given, remedy)
    ranges = [key for key in ("non_gaussian", "almost_gaussian") if key in table]
    for key in [*ranges, "nonintegrable_better_with"]:
        if key in table and curves < 2:
            raise BadInput(f"{label}: expect.{key}: is about the curves of [vary]; add it")
    if ranges and len(by_name[name]) > 1:
        raise BadInput(f"{label}: expect.{ranges[0]}: is for one coordinate, not a pair")
    return Expect(**{**table, "of": by_name[name]})
