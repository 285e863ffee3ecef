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

    The file is replaced whole at every point, so that a killed run leaves all points before; its
    first line is a hash of the grid's ``identity``, all that its numbers depend on, and each later
    line ends with a hash of the previous line and of its own point. A file that was changed or
    belongs to another run is refused and not modified; an incomplete last line, as a power cut may
    leave it, is left out with a warning. The caller has ``claimed`` the folder before it adds.
    """

    def __init__(self, folder: Path | None, identity: Record) -> None:
        """Read the file, if any; raise ``BadInput`` if it is damaged or belongs to another run."""
        self._path = None if folder is None else folder / POINTS_FILE
        self._hash = fingerprint(identity)
        self._text = f"{self._hash}\n"
        self.points: dict[tuple[float, ...], SweepPoint] = {}
        if self._path is None or not lexists(self._path):
            return
        what = "the file of a grid's points"
        stored = read_text(self._path, str(self._path), most=POINTS_BYTES, what=what)
        own, whole = self._hash, 0
        head, *lines = stored.removesuffix("\n").split("\n")
        for line in lines if head == own else ():
            body = line.rpartition(CHECK)[0] + "}"
            if self._line(body) != line:
                break
            self._append(body)
            point = SweepPoint.read(json.loads(body))
            self.points[point.values] = point
            whole += 1
        rest = lines[whole:] if head == own else [head, *lines]
        if len(rest) > 1 or not own.startswith(head):
            raise BadInput(
                f"{self._path}: is damaged or another run's; give another --out or remove the file"
            )
        if any(rest):
            words = "its last line is torn and left out; what was in it is computed again"
            warnings.warn(f"{self._path}: {words}", stacklevel=2)

    def add(self, point: SweepPoint) -> None:
        """Store a finished point; with a folder also in its file, which is replaced whole.

        A run that is killed later keeps the point. Raises ``BadInput`` if it cannot be written.
        """
        self.points[point.values] = point
        self._append(json.dumps(plain(point), allow_nan=False))
        if self._path is not None:
            write_text(self._path, self._text)

    def _line(self, body: str) -> str:
        """Return the next line of the file: the JSON object ``body`` of a point with its hash."""
        own = sha256((self._hash + body).encode()).hexdigest()
        return f'{body[:-1]}{CHECK}{own}"}}'

    def _append(self, body: str) -> None:
        line = self._line(body)
        self._hash, self._text = line[-66:-2], f"{self._text}{line}\n"
