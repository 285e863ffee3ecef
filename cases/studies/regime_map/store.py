"""Finished points of a map on disk, one JSON line each: an interrupted map goes on from there."""

import json
from dataclasses import fields, replace
from os.path import lexists
from pathlib import Path
from typing import Any

from cases.output.files import write_text
from cases.output.records import hash_of, plain
from cases.scene.errors import BadInput
from cases.scene.reading import read_text
from cases.studies.regime_map.points import MapPoint

NAME = "points.jsonl"
"""Name of the file in a map's folder."""
FORMAT = 3
"""Version of the lines: each ends with its own hash, the first holds the identity of the map."""
MAX_BYTES = 64 << 20
"""Largest file that is read: some hundred times the points that a map may have."""


class PointStore:
    """The points of one map in ``folder``, or in memory only where there is no folder.

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
        try:
            with self._path.open("a", encoding="utf-8", newline="\n") as stream:
                stream.write(_line(point))
        except OSError as error:
            raise BadInput(
                f"{self._path}: cannot be written: {error.strerror or error}; make room, then start"
                " again: the points before this one are kept"
            ) from None

    def _read(self, path: Path) -> bool:
        """Read the file's points; return whether it is whole, down to the end of its last line."""
        text = read_text(path, str(path), most=MAX_BYTES, what="the file of a map's points")
        if not text:  # as a full disk leaves it
            return False
        head, *lines, last = text.split("\n")
        if _record(head).get("map") != self._head["map"]:
            raise BadInput(
                f"{path}: holds points of another map (other scene, observable, settings or"
                " version); give another --out or remove the file"
            )
        names = {field.name for field in fields(MapPoint)}
        for number, line in enumerate(lines, start=2):
            record, words = _record(line), "is not what was written"
            if record.keys() == names:
                tuples = {key: tuple(record[key]) for key in ("values", "problems")}
                point = MapPoint(**{**record, **tuples})
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


def _record(line: str) -> dict[str, Any]:
    """Return the record of one line, or nothing where it is not as ``_line`` wrote it."""
    try:
        record = json.loads(line)
        stated = record.pop("hash")
        return record if stated == hash_of(record) else {}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}
