"""The points of a map: what each theory is worth at one, and the finished ones on disk."""

import json
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from os.path import lexists
from pathlib import Path
from time import perf_counter

from cases.comparison.compare import distance_between
from cases.output.files import write_text
from cases.output.records import Record, plain
from cases.scene.errors import BadInput
from cases.scene.reading import read_text
from cases.studies.simulation import best_answer, deterministic
from fpk.clearance import stop_clearances
from fpk.errors import NotApplicable
from fpk.method import Method
from fpk.observable import Observable
from fpk.system import System
from sim.montecarlo import MonteCarlo

THEORIES = ("nonintegrable", "integrable")
"""Averaged methods that are mapped, in the order of the pictures."""
UNDECIDED, NEITHER = "undecided", "neither"
"""Winners where the difference is within the errors, and where no theory applies."""
NAME = "points.jsonl"
"""Name of the file in a map's folder."""
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
    system: System,
    observable: Observable,
    values: tuple[float, ...],
    solver: Method | None,
    simulation: MonteCarlo,
) -> MapPoint:
    """Return what each theory is worth for ``observable`` of ``system``.

    The reference is an exact density of the full system; where there is none that of ``solver``,
    if it is given and certifies its answer; ``simulation`` else.
    """
    start = perf_counter()
    problems: list[str] = []
    reference = best_answer(deterministic("full"), system, observable, problems)
    if reference is None and solver is not None:
        with suppress(NotApplicable):
            reference = best_answer([solver.unasked(system)], system, observable, [])
        if reference is not None and not reference[1].certificate.certified:
            reference = None
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

    The file is replaced whole at every point, so that a killed run leaves all points before; its
    first line is a hash of the map's ``identity``, all that its numbers depend on, and the lines
    below. A file that was changed or is another map's is refused and stays as it is. Who adds
    points has ``claimed`` the folder.
    """

    def __init__(self, folder: Path | None, identity: Record) -> None:
        """Read what is there; raise ``BadInput`` for a damaged file, or that of another map."""
        self._path = None if folder is None else folder / NAME
        self._identity = json.dumps(plain(identity), ensure_ascii=False)
        self._lines = ""
        self.points: dict[tuple[float, ...], MapPoint] = {}
        if self._path is None or not lexists(self._path):
            return
        what = "the file of a map's points"
        text = read_text(self._path, str(self._path), most=MAX_BYTES, what=what)
        self._lines = text.partition("\n")[2]
        if text and text != self._text():  # a power cut may leave it empty
            raise BadInput(
                f"{self._path}: is damaged or another map's; give another --out or remove the file"
            )
        for record in map(json.loads, self._lines.splitlines()):
            tuples = {key: tuple(record[key]) for key in ("values", "problems")}
            point = MapPoint(**{**record, **tuples})
            self.points[point.values] = point

    def add(self, point: MapPoint) -> None:
        """Store a finished point, on disk before anything else is done."""
        self.points[point.values] = point
        self._lines += json.dumps(plain(point), allow_nan=False) + "\n"
        if self._path is not None:
            write_text(self._path, self._text())

    def _text(self) -> str:
        return f"{sha256((self._identity + self._lines).encode()).hexdigest()}\n{self._lines}"
