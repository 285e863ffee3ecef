"""The answers at the points of a grid, in memory and on disk, a JSON line each."""

import json
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from os.path import lexists
from pathlib import Path

from cases.scene.errors import BadInput
from cases.scene.scene import read_text
from cases.show.files import write_text
from cases.show.records import Record, plain
from fpk.numeric.recognition import fingerprint


@dataclass(frozen=True)
class Value:
    """A quantity by one method: ``value`` ± ``error``, both None if the method gave no value.

    ``error_kind`` is "numerical" (``error`` is an estimate of it) or "sampling" (one standard
    error). ``failures`` has the reasons why a value is not ``certified``, ``reason`` why there is
    no value; ``failed`` is True if the method applies and did not succeed. If the quantity is an
    averaging error, ``reference`` is the route that solved the full system.
    """

    quantity: str
    method: str
    value: float | None = None
    error: float | None = None
    error_kind: str = ""
    certified: bool = False
    failures: tuple[str, ...] = ()
    reason: str = ""
    failed: bool = False
    reference: str = ""

    @property
    def applies(self) -> bool:
        """Whether the method applies: it gave a value or failed to give it."""
        return self.value is not None or self.failed


@dataclass(frozen=True)
class SweepPoint:
    """The answers at one point of the grid, for each quantity by every method in turn."""

    values: tuple[float, ...]
    answers: tuple[Value, ...]
    seconds: float

    @property
    def problems(self) -> tuple[str, ...]:
        """One sentence for each failure of a certificate and for each answer that failed."""
        return tuple(
            f"{a.quantity} by {a.method} {words}"
            for a in self.answers
            for words in (
                *(f"is not certified: {failure}" for failure in a.failures),
                *([f"failed: {a.reason}"] if a.failed else []),
            )
        )

    @classmethod
    def read(cls, record: Record) -> "SweepPoint":
        """Return the point that ``record``, read from its JSON line, describes."""
        own = [Value(**{**r, "failures": tuple(r["failures"])}) for r in record["answers"]]
        return cls(tuple(record["values"]), tuple(own), record["seconds"])

    def by(self, methods: Sequence[str]) -> "SweepPoint":
        """Return the point with the answers of ``methods`` alone."""
        return replace(self, answers=tuple(a for a in self.answers if a.method in methods))


POINTS_FILE = "points.jsonl"
"""Name of the file in a grid's folder."""
CHECK = ', "check": "'
"""Key of the hash that ends each line of the file, as JSON writes it."""
POINTS_BYTES = 64 << 20
"""Largest file that is read, in bytes: a hundred times the size of ``GRID_POINTS`` points."""


class PointStore:
    """The points of one grid in ``folder``, one JSON line each, or in memory where it is None.

    The file is replaced whole at every point, so that a killed run leaves all points before. Each
    line ends with a hash of its point and of the grid's ``identity``, all that its numbers depend
    on. Lines that were changed or are incomplete, as a power cut may leave the last, are left out
    with a warning; a file of other lines alone is refused and not modified. The caller has
    ``claimed`` the folder before it adds.
    """

    def __init__(self, folder: Path | None, identity: Record) -> None:
        """Read the file, if any; raise ``BadInput`` if no line in it is a point of this grid."""
        self._path = None if folder is None else folder / POINTS_FILE
        self._identity, self._text = fingerprint(identity), ""
        self.points: dict[tuple[float, ...], SweepPoint] = {}
        if self._path is None or not lexists(self._path):
            return
        what = "the file of a grid's points"
        stored = read_text(self._path, str(self._path), most=POINTS_BYTES, what=what)
        lines = stored.removesuffix("\n").split("\n") if stored else []
        for line in lines:
            body = line.rpartition(CHECK)[0] + "}"
            if self._line(body) == line:
                self._text += f"{line}\n"
                point = SweepPoint.read(json.loads(body))
                self.points[point.values] = point
        if lines and not self.points:
            raise BadInput(
                f"{self._path}: is damaged or another run's; give another --out or remove the file"
            )
        if wrong := len(lines) - self._text.count("\n"):
            words = "torn or changed, left out; what was there is computed again"
            warnings.warn(f"{self._path}: {wrong} of its lines {words}", stacklevel=2)

    def add(self, point: SweepPoint) -> None:
        """Store a finished point; with a folder also in its file, which is replaced whole.

        A run that is killed later keeps the point. Raises ``BadInput`` if it cannot be written.
        """
        self.points[point.values] = point
        self._text += f"{self._line(json.dumps(plain(point), allow_nan=False))}\n"
        if self._path is not None:
            write_text(self._path, self._text)

    def _line(self, body: str) -> str:
        """Return the line of the file for the JSON object ``body`` of a point, with its hash."""
        own = sha256((self._identity + body).encode()).hexdigest()
        return f'{body[:-1]}{CHECK}{own}"}}'
