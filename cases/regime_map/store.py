"""Finished points of a map on disk, one JSON line each: an interrupted map goes on from there."""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cases.errors import BadInput
from cases.files import write_text
from cases.regime_map.points import MapPoint
from cases.summary import plain

NAME = "points.jsonl"


class PointStore:
    """The points of one map in ``folder``, or in memory only where there is no folder.

    ``identity`` is everything that a point's numbers depend on beside its own values; points of
    another identity are refused, not mixed in. A last line that was cut off is dropped.
    """

    def __init__(self, folder: Path | None, identity: dict[str, Any]) -> None:
        """Read what is there; raise ``BadInput`` for a file of another map."""
        self._path = None if folder is None else folder / NAME
        self._head = {"map": hash_of(identity), "identity": plain(identity)}
        self.points: dict[tuple[float, ...], MapPoint] = {}
        if self._path is not None:
            if self._path.exists():
                self._read(self._path)
            self._rewrite(self._path)

    def add(self, point: MapPoint) -> None:
        """Keep a finished point, on disk before anything else is done."""
        self.points[point.values] = point
        if self._path is not None:
            try:
                with self._path.open("a", encoding="utf-8") as stream:
                    stream.write(_line(asdict(point)))
                    stream.flush()
            except OSError as error:
                words = error.strerror or error
                raise BadInput(f"{self._path}: cannot be written: {words}") from None

    def _read(self, path: Path) -> None:
        foreign = BadInput(
            f"{path}: holds points of another map (other scene, observable, settings or version);"
            " give another --out or remove the file"
        )
        try:
            lines = path.read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError):
            raise BadInput(f"{path}: cannot be read; give another --out") from None
        for number, line in enumerate(lines):
            try:
                record = json.loads(line)
                if number == 0:
                    if record["map"] != self._head["map"]:
                        raise foreign
                    continue
                point = _point(record)
            except BadInput:
                raise
            except (ValueError, KeyError, TypeError):
                if 0 < number == len(lines) - 1:  # cut off when the program was stopped
                    continue
                raise foreign from None
            self.points[point.values] = point

    def _rewrite(self, path: Path) -> None:
        lines = [_line(self._head), *(_line(asdict(p)) for p in self.points.values())]
        write_text(path, "".join(lines))


def hash_of(identity: dict[str, Any]) -> str:
    """Return a short hash of everything in ``identity``."""
    text = json.dumps(plain(identity), sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _line(record: dict[str, Any]) -> str:
    return json.dumps(plain(record), ensure_ascii=False, allow_nan=False) + "\n"


def _point(record: dict[str, Any]) -> MapPoint:
    lists = {key: tuple(record[key]) for key in ("values", "problems")}
    return MapPoint(**{**record, **lists})
