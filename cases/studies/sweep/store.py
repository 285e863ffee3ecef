"""The finished points of a grid on disk, one JSON line each."""

import json
from hashlib import sha256
from os.path import lexists
from pathlib import Path

from cases.output.files import write_text
from cases.output.records import Record, plain
from cases.scene.errors import BadInput
from cases.scene.reading import read_text
from cases.studies.sweep.result import SweepPoint

NAME = "points.jsonl"
"""Name of the file in a grid's folder."""
MAX_BYTES = 64 << 20
"""Largest file that is read: some hundred times the points that a grid may have."""


class PointStore:
    """The points of one grid in ``folder``, one JSON line each, or in memory where it is None.

    The file is replaced whole at every point, so that a killed run leaves all points before; its
    first line is a hash of the grid's ``identity``, all that its numbers depend on, and the lines
    below. A file that was changed or is another run's is refused and stays as it is. Who adds
    points has ``claimed`` the folder.
    """

    def __init__(self, folder: Path | None, identity: Record) -> None:
        """Read what is there; raise ``BadInput`` for a damaged file, or that of another run."""
        self._path = None if folder is None else folder / NAME
        self._identity = json.dumps(plain(identity), ensure_ascii=False)
        self._lines = ""
        self.points: dict[tuple[float, ...], SweepPoint] = {}
        if self._path is None or not lexists(self._path):
            return
        what = "the file of a grid's points"
        text = read_text(self._path, str(self._path), most=MAX_BYTES, what=what)
        self._lines = text.partition("\n")[2]
        if text and text != self._text():  # a power cut may leave it empty
            raise BadInput(
                f"{self._path}: is damaged or another run's; give another --out or remove the file"
            )
        for record in map(json.loads, self._lines.splitlines()):
            point = SweepPoint.read(record)
            self.points[point.values] = point

    def add(self, point: SweepPoint) -> None:
        """Store a finished point, on disk before anything else is done."""
        self.points[point.values] = point
        self._lines += json.dumps(plain(point), allow_nan=False) + "\n"
        if self._path is not None:
            write_text(self._path, self._text())

    def _text(self) -> str:
        return f"{sha256((self._identity + self._lines).encode()).hexdigest()}\n{self._lines}"
