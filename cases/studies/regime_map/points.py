"""The points of a map: what each theory is worth at one, and the finished ones on disk."""

import json
from dataclasses import dataclass, replace
from os.path import lexists
from pathlib import Path
from time import perf_counter
from typing import Any

from cases.comparison.compare import distance_between
from cases.output.files import write_text
from cases.output.records import hash_of, plain
from cases.scene.errors import BadInput, readable_errors
from cases.scene.reading import read_text
from cases.studies.simulation import best_answer, deterministic
from fpk.clearance import stop_clearances
from fpk.observable import Observable
from fpk.system import System
from sim.montecarlo import MonteCarlo

THEORIES = ("nonintegrable", "integrable")
"""Averaged methods that are mapped, in the order of the pictures."""
UNDECIDED, NEITHER = "undecided", "neither"
"""Winners where the difference is within the errors, and where no theory applies."""
NAME = "points.jsonl"
"""Name of the file in a map's folder."""
FORMAT = 3
"""Version of the file: each line ends with its own hash, the first holds the map's identity."""
MAX_BYTES = 64 << 20
"""Largest file that is read: some hundred times the points that a map may have."""


@dataclass(frozen=True)
class MapPoint:
    """Measured distances of the theories at one grid point.

    ``L1`` and ``error`` by theory; a theory that does not apply is left out. ``reference`` is the
    route that they are held against; ``rms_ratio`` the smallest clearance over the rms displacement
    without contact; ``winner`` the nearer theory, or ``UNDECIDED``, or ``NEITHER``; ``problems``
    what failed or was not certified.
    """

    values: tuple[float, ...]
    L1: dict[str, float]
    error: dict[str, float]
    reference: str
    rms_ratio: float | None
    winner: str
    problems: tuple[str, ...]
    seconds: float


def map_point(
    system: System, observable: Observable, values: tuple[float, ...], simulation: MonteCarlo
) -> MapPoint:
    """Return what each theory is worth for ``observable`` of ``system``.

    The reference is a route that solves the full system, ``simulation`` where none does.
    """
    start = perf_counter()
    problems: list[str] = []
    reference = best_answer(deterministic("full"), system, observable, problems)
    reference = reference or best_answer([simulation], system, observable, problems)
    distances = {}
    for theory in THEORIES:
        own = [m for m in deterministic("averaged") if m.route.method == theory]
        answer = best_answer(own, system, observable, problems)
        if answer is not None and reference is not None:
            distances[theory] = distance_between(answer[1], reference[1])[:2]
    ratios = [s.ratio for s in stop_clearances(system) if s.ratio is not None]
    return MapPoint(
        values=values,
        L1={name: d[0] for name, d in distances.items()},
        error={name: d[1] for name, d in distances.items()},
        reference="" if reference is None else reference[0],
        rms_ratio=min(ratios, default=None),
        winner=winner_of(distances),
        problems=tuple(problems),
        seconds=perf_counter() - start,
    )


def winner_of(distances: dict[str, tuple[float, float]]) -> str:
    """Return the theory whose distance is smaller beyond the errors of both."""
    if not distances:
        return NEITHER
    nearer, *others = sorted(distances, key=lambda name: distances[name][0])
    slack = sum(error for _, error in distances.values())
    clear = all(distances[other][0] - distances[nearer][0] > slack for other in others)
    return nearer if clear else UNDECIDED


class PointStore:
    """The points of one map in ``folder``, one JSON line each, or in memory where it is None.

    ``identity`` is everything that a point's numbers depend on beside its own values. A file of
    another identity, or with any line that is not what was written, is refused. A last line without
    its end, which a killed run leaves, is dropped, and ``note`` says so.
    """

    def __init__(self, folder: Path | None, identity: dict[str, Any]) -> None:
        """Read what is there; raise ``BadInput`` for a file of another map or a damaged one."""
        self._path = None if folder is None else folder / NAME
        record = plain(identity)
        self._head = {"map": hash_of({**record, "format": FORMAT}), "identity": record}
        self.points: dict[tuple[float, ...], MapPoint] = {}
        self.note: str | None = None
        if self._path is not None and not (lexists(self._path) and self._read(self._path)):
            write_text(self._path, "".join(map(_line, [self._head, *self.points.values()])))

    def add(self, point: MapPoint) -> None:
        """Store a finished point, on disk before anything else is done."""
        self.points[point.values] = point
        if self._path is None:
            return
        remedy = "make room, then start again: the points before this one are kept"
        refusal = readable_errors(self._path, "cannot be written", remedy)
        with refusal, self._path.open("a", encoding="utf-8", newline="\n") as stream:
            stream.write(_line(point))

    def _read(self, path: Path) -> bool:
        """Read the file's points; return whether it is whole, down to the end of its last line."""
        text = read_text(path, str(path), most=MAX_BYTES, what="the file of a map's points")
        if not text:  # as a full disk leaves it
            return False
        head, *lines, last = text.split("\n")
        if f"{head}\n" != _line(self._head):
            raise BadInput(
                f"{path}: holds points of another map (other scene, observable, settings or"
                " version); give another --out or remove the file"
            )
        for number, line in enumerate(lines, start=2):
            words = "is not what was written"
            if point := _point(line):
                known = self.points.setdefault(point.values, point)
                if replace(known, seconds=point.seconds) == point:  # two runs at once write twice
                    continue
                words = "has other numbers than an earlier line of its point"
            raise BadInput(
                f"{path}: line {number} {words}: the file is damaged; remove that line, its point"
                " is then computed again"
            )
        if last:
            count = len(self.points)
            self.note = f"{path}: the last line was cut off and is dropped; {count} points are kept"
        return not last


def _line(content: Any) -> str:
    """One line: ``content`` and its own hash, in ASCII, which can be cut anywhere."""
    record = plain(content)
    return json.dumps({**record, "hash": hash_of(record)}, allow_nan=False) + "\n"


def _point(line: str) -> MapPoint | None:
    """Return the point of one line, None where it is not as ``_line`` wrote it."""
    try:
        record = json.loads(line)
        intact = record.pop("hash") == hash_of(record)
        tuples = {key: tuple(record[key]) for key in ("values", "problems")}
        return MapPoint(**{**record, **tuples}) if intact else None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
