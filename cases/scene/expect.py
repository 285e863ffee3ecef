"""What a source claims of its figure in words, read from ``[expect]`` and checked."""

from dataclasses import dataclass
from math import inf
from typing import Literal, get_args

from cases.scene.errors import BadInput, refused
from cases.scene.schema import ExpectTable, RangeTable
from cases.scene.vary import Curve
from fpk.errors import InvalidInput
from fpk.observable import Observable, observable_name, parse_observable

Theory = Literal["nonintegrable", "integrable"]
Direction = Literal["larger", "smaller"]


@dataclass(frozen=True)
class Range:
    """Values of the varied number, ``low`` to ``high``; ``words`` as the scene gives it."""

    low: float
    high: float
    closed: bool
    words: str

    def __contains__(self, value: float) -> bool:
        """Return whether ``value`` lies in the range."""
        if self.closed:
            return self.low <= value <= self.high
        return self.low < value < self.high


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
    table: ExpectTable | None,
    observables: tuple[Observable, ...],
    curves: tuple[Curve, ...],
    label: str,
) -> Expect | None:
    """Return the checked claims; raise ``BadInput`` for one that the scene cannot test."""
    if table is None:
        return None
    of = _observable(table.of, observables, label)
    ranges = {
        key: _range(part, f"expect.{key}", label)
        for key in ("non_gaussian", "almost_gaussian")
        if (part := getattr(table, key)) is not None
    }
    direction = table.nonintegrable_better_with
    if direction is not None and direction not in get_args(Direction):
        remedy = 'use "larger" or "smaller"'
        raise refused(label, "expect.nonintegrable_better_with", direction, remedy)
    for key in [*ranges, *(["nonintegrable_better_with"] if direction else [])]:
        if len(curves) < 2:
            raise BadInput(f"{label}: expect.{key}: is about the curves of [vary]; add it")
    if ranges and len(of) > 1:
        raise BadInput(f"{label}: expect.{next(iter(ranges))}: is for one coordinate, not a pair")
    better = _theories(table.better, "expect.better", label)
    rule = table.clearance_rule
    if rule is not None and rule <= 0:
        raise refused(label, "expect.clearance_rule", rule, "must be > 0")
    return Expect(
        of=of,
        nonintegrable_better_with=direction,  # type: ignore[arg-type]  # checked above
        better=(better[0], better[1]) if better else None,
        acceptable=_theories(table.acceptable, "expect.acceptable", label),
        clearance_rule=rule,
        **ranges,
    )


def _observable(name: str | None, observables: tuple[Observable, ...], label: str) -> Observable:
    names = [observable_name(o) for o in observables]
    if name is None:
        return observables[0]
    try:
        wanted = parse_observable(name, 10**4)
    except InvalidInput:
        wanted = ()
    if wanted not in observables:
        raise refused(label, "expect.of", name, f"is not observed here; use {', '.join(names)}")
    return wanted


def _range(table: RangeTable, key: str, label: str) -> Range:
    given = {end: value for end, value in table.model_dump().items() if value is not None}
    if len(given) != 1:
        raise BadInput(f"{label}: {key}: must have exactly one of above, below, at_least, at_most")
    ((end, value),) = given.items()
    low, high = (value, inf) if end in ("above", "at_least") else (-inf, value)
    words = {"above": ">", "below": "<", "at_least": "≥", "at_most": "≤"}[end]
    return Range(low, high, closed=end.startswith("at"), words=f"{words} {value:g}")


def _theories(names: list[str] | None, key: str, label: str) -> tuple[Theory, ...]:
    for i, name in enumerate(names or ()):
        if name not in get_args(Theory):
            remedy = f"use {' or '.join(get_args(Theory))}"
            raise refused(label, f"{key}[{i + 1}]", name, remedy)
    if names and len(set(names)) != len(names):
        raise refused(label, key, names, "names the same theory twice")
    return tuple(names or ())  # type: ignore[arg-type]  # checked above
