"""Claims of a scene's source about its figure, read from the table ``[expect]``."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import ge, gt, le, lt
from typing import Any, Literal

from fpk.answer.names import Observable, observable_name
from fpk.numeric.errors import InvalidInput, require

Theory = Literal["nonintegrable", "integrable"]

RELATIONS: dict[str, tuple[str, Callable[[float, float], bool]]] = {
    "above": (">", gt),
    "below": ("<", lt),
    "at_least": ("≥", ge),
    "at_most": ("≤", le),
}
"""Key of a relation in a scene: its sign, and the test of (number, limit)."""

Range = tuple[str, float]
"""Range of a number: a key of ``RELATIONS`` and the limit, as ("at_most", 0.1): x <= 0.1."""


def range_of(key: str, given: Mapping[str, float]) -> Range:
    """Return the only item (relation, limit) of ``given``.

    Raises ``InvalidInput`` about ``key`` if there is none, or if there are several.
    """
    require(len(given) == 1, key, given, f"must have exactly one of {', '.join(RELATIONS)}")
    return next(iter(given.items()))


@dataclass(frozen=True)
class Expect:
    """The claims of one figure; None for a claim that the source does not make.

    ``of``: the density of the claims. ``non_gaussian``, ``almost_gaussian``: range of the varied
    number on whose curves it is so. ``nonintegrable_better_with``: along the varied number in this
    direction the L1 distance of that theory to the full system falls. ``better``: the first theory
    is nearer to the full system than the second. ``acceptable``: theories whose L1 distance to the
    full system is below 0.1. ``clearance_rule``: the integrable theory is acceptable if every
    clearance exceeds this many rms displacements; if not, the converse is tested.
    """

    of: Observable
    non_gaussian: Range | None = None
    almost_gaussian: Range | None = None
    nonintegrable_better_with: Literal["larger", "smaller"] | None = None
    better: tuple[Theory, Theory] | None = None
    acceptable: tuple[Theory, ...] = ()
    clearance_rule: float | None = None


def expect_of(
    table: Mapping[str, Any] | None, observables: Sequence[Observable], *, curves: int
) -> Expect | None:
    """Return the claims of the [expect] ``table`` of a scene with ``curves`` curves, None for None.

    Without "of" they are about the first of the observed ``observables``. Raises ``InvalidInput``
    if "of" is not observed, for a range without exactly one relation, for a Gaussian claim on a
    pair, and, with a single curve, for a Gaussian claim or ``nonintegrable_better_with``.
    """
    if table is None:
        return None
    by_name = {observable_name(o): o for o in observables}
    given = table.get("of", next(iter(by_name)))
    name = ",".join(part.strip() for part in given.split(","))
    remedy = f"is not observed here; use {', '.join(by_name)}"
    require(name in by_name, "expect.of", given, remedy)
    claims = {**table, "of": by_name[name]}
    for key in table.keys() & {"non_gaussian", "almost_gaussian"}:
        claims[key] = range_of(f"expect.{key}", table[key])
        if len(by_name[name]) > 1:
            raise InvalidInput(f"expect.{key}", table[key], "is for one coordinate, not a pair")
    for key in table.keys() & {"non_gaussian", "almost_gaussian", "nonintegrable_better_with"}:
        remedy = "is about the curves of [vary]; add it"
        require(curves > 1, f"expect.{key}", table[key], remedy)
    return Expect(**claims)
