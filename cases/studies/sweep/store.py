"""The finished points of a grid on disk, one JSON line each."""

import json
import warnings
from hashlib import sha256
from os.path import lexists
from pathlib import Path

from cases.output.files import write_text
from cases.output.records import Record, plain
from cases.scene.errors import BadInput
from cases.scene.reading import read_text
from cases.studies.sweep.result import SweepPoint
from fpk.recognition import fingerprint

NAME = "points.jsonl"
"""Name of the file in a grid's folder."""
CHECK = ', "check": "'
"""Key of the hash that ends each line of the file, as JSON writes it."""
MAX_BYTES = 64 << 20
"""Largest file that is read: some hundred times the points that a grid may have."""


class PointStore:
    """The points of one grid in ``folder``, one JSON line each, or in memory where it is None.

    The file is replaced whole at every point, so that a killed run leaves all points before; its
    first line is a hash of the grid's ``identity``, all that its numbers depend on, and each later
    line ends with a hash of the line before it and of its own point. A file that was changed or is
    another run's is refused and stays as it is; a last line that is not whole, as a power cut may
    leave it, is left out with a warning. Who adds points has ``claimed`` the folder.
    """

    def __init__(self, folder: Path | None, identity: Record) -> None:
        """Read what is there; raise ``BadInput`` for a damaged file, or that of another run."""
        self._path = None if folder is None else folder / NAME
        self._hash = fingerprint(identity)
        self._text = f"{self._hash}\n"
        self.points: dict[tuple[float, ...], SweepPoint] = {}
        if self._path is None or not lexists(self._path):
            return
        what = "the file of a grid's points"
        stored = read_text(self._path, str(self._path), most=MAX_BYTES, what=what)
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
        """Store a finished point, on disk before anything else is done."""
        self.points[point.values] = point
        self._append(json.dumps(plain(point), allow_nan=False))
        if self._path is not None:
            write_text(self._path, self._text)

    def _line(self, body: str) -> str:
        """The next line of the file: a point, a JSON object, with its hash."""
        own = sha256((self._hash + body).encode()).hexdigest()
        return f'{body[:-1]}{CHECK}{own}"}}'

    def _append(self, body: str) -> None:
        line = self._line(body)
        self._hash, self._text = line[-66:-2], f"{self._text}{line}\n"
