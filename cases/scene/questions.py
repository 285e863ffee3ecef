"""Questions of a scene about motion after a start: the tables [[transient]] and [[passage]]."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from cases.scene.errors import about_key
from cases.scene.expect import Range, Theory, range_of
from fpk.answer.dynamics import require_times
from fpk.answer.names import (
    REST,
    Limit,
    Observable,
    Start,
    observable_name,
    parse_limit,
    parse_observable,
    parse_start,
)
from fpk.numeric.errors import InvalidInput, require
from fpk.system.linear import modal_energies
from fpk.system.system import System


@dataclass(frozen=True)
class TransientQuestion:
    """The question for the densities of one coordinate, ``of``, at ``times`` after ``start``.

    ``times`` are > 0 and ascend, in the scene's unit of time.
    """

    of: Observable
    start: Start
    times: tuple[float, ...]

    @property
    def name(self) -> str:
        """Observable and start in words, as ``H from rest``."""
        return f"{observable_name(self.of)} from {self.start}"


@dataclass(frozen=True)
class PassageQuestion:
    """The question for the time T at which ``limit`` is first passed after ``start``.

    Its answer has the moments of T, the failure rate and P(T > t) at ``times``, >= 0 and ascending.
    The averaging error of ``theory`` in a number x is |x averaged − x full|/x full. ``rate_error``:
    claimed range of the averaging error of the failure rate; ``failure_error``: of P(T <= t), at
    the time at which it is largest; None without a claim.
    """

    limit: Limit
    start: Start
    times: tuple[float, ...] = ()
    theory: Theory = "nonintegrable"
    rate_error: Range | None = None
    failure_error: Range | None = None

    @property
    def name(self) -> str:
        """Limit and start in words, as ``H=1.5 from rest`` or ``H1=0.4 or H2=0.6 from rest``."""
        return f"{' or '.join(str(self.limit).split(','))} from {self.start}"


Question = TransientQuestion | PassageQuestion


def passages_of(tables: Sequence[Mapping[str, Any]], system: System) -> tuple[PassageQuestion, ...]:
    """Return the questions of [[passage]]: from rest without "start"; ``times`` may be empty.

    Raises ``InvalidInput`` naming table, key and value, also as ``require_below`` does, and for
    "failure_error" without times.
    """
    questions = []
    for k, table in enumerate(tables, start=1):
        with _name_table(f"passage[{k}]"):
            limit = parse_limit(table["limit"], system.n)
            start = _start(table, system)
            require_below(system, limit, start)
            times = _times(table)
            ranges = [key for key in ("rate_error", "failure_error") if key in table]
            claims: dict[str, Any] = {key: range_of(key, table[key]) for key in ranges}
            known = times or "failure_error" not in claims
            require(known, "times", None, "failure_error is about them; add them")
        claims |= {key: table[key] for key in table.keys() & {"theory"}}
        questions.append(PassageQuestion(limit, start, times, **claims))
    return tuple(questions)


def transients_of(
    tables: Sequence[Mapping[str, Any]], system: System
) -> tuple[TransientQuestion, ...]:
    """Return the questions of [[transient]]: from rest without "start".

    Raises ``InvalidInput`` naming table, key and value, also for a pair and for a time of 0.
    """
    questions = []
    for k, table in enumerate(tables, start=1):
        with _name_table(f"transient[{k}]"):
            with about_key("of", table["of"]):
                of = parse_observable(table["of"], system.n)
            require(len(of) == 1, "of", table["of"], "must be one coordinate, not a pair")
            start, times = _start(table, system), _times(table)
            if times[0] == 0.0:
                raise InvalidInput("times", list(times), "must be > 0: at 0 there is no density")
        questions.append(TransientQuestion(of, start, times))
    return tuple(questions)


@contextmanager
def _name_table(place: str) -> Iterator[None]:
    """Re-raise an ``InvalidInput`` of the block with ``place``, as passage[1], before its key."""
    try:
        yield
    except InvalidInput as error:
        raise InvalidInput(f"{place}.{error.key}", error.value, error.remedy) from None


def _start(table: Mapping[str, Any], system: System) -> Start:
    return parse_start(table["start"], system) if "start" in table else REST


def _times(table: Mapping[str, Any]) -> tuple[float, ...]:
    times = table.get("times", [])
    with about_key("times", times):
        require_times(np.array(times, dtype=float))
    return tuple(map(float, times))


def require_below(system: System, limit: Limit, start: Start) -> None:
    """Raise ``InvalidInput`` if a q_i, v_i, H or H_m that ``start`` gives is beyond its ``limit``.

    A state gives all of them, an energy H alone, modal energies also their sum, a lower bound of H.
    The other quantities are not known yet; methods check the states from which they start.
    """
    least, passed = dict(start.values), False
    if start.kind == "state":
        q, p = start.state(system.n)
        least = {f"H{m + 1}": H for m, H in enumerate(modal_energies(system, q, p))}
        least["H"] = float(system.hamiltonian(q, p))
        if not limit.of_energy:
            passed = bool(limit.distance(q, p / system.mass) <= 0.0)
    elif start.kind == "modal":
        least["H"] = sum(least.values())  # and what is stored in contacts
    if limit.of_energy:
        passed = any(least.get(name, 0.0) >= value for name, value in limit.values.items())
    require(not passed, "start", str(start), f"must lie within the limit {limit}")
