"""Descriptions of pictures: curves over one axis, maps over two.

Each is drawn twice: by ``pictures/draw.py`` with matplotlib, and by the scripts of a page, which
read ``Panel.record`` and ``Field.record``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np

from cases.show.page import round_values
from cases.show.pictures.style import COLOURS, DASHES, MARKERS
from cases.show.records import Record
from cases.show.variables import Axis
from cases.show.words import reader_words
from fpk.numeric.arrays import EPS, Array

SAME_LINE = 0.007
"""Distance of two lines, relative to the height of a picture, that the width of a line hides."""
DECADES = 100.0
"""Ratio of the largest to the smallest value from which an axis is logarithmic."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Values ``y`` over ``x``, equally long, with their ``name`` in the legend.

    ``bar`` has the error of each value: bars of ± ``bars`` errors are drawn at markers, and a band
    if ``band``; with ``bars`` 0 only the page's read-out says it. ``style`` is a key of ``DASHES``,
    or "none" if the points are not joined. ``marker`` is a key of ``MARKERS``, empty for none; None
    takes the next of them, as an empty ``colour`` takes the next of ``COLOURS``. Curves of one
    ``group`` should have one colour; dashes and markers distinguish their names. ``brief`` is the
    name in a drawn picture, if that is another. ``dashed`` are (x, y) of a line of theory,
    ``notes`` have the words of the page about each point. A curve that is not ``shown`` appears in
    the page on demand; ``form`` names the closed form that its script evaluates.
    """

    name: str
    x: Sequence[float] | Array
    y: Sequence[float] | Array
    bar: Array | None = None
    dashed: tuple[Array, Array] | None = None
    style: str = "-"
    notes: Sequence[str] = ()
    group: str = ""
    brief: str = ""
    colour: str = ""
    marker: str | None = None
    bars: int = 1
    band: bool = False
    shown: bool = True
    form: str = ""

    @property
    def legend(self) -> str:
        """The name in the legend of a drawn picture, with ``±2 s.e.`` if bars of 2 errors are."""
        errors = ", ±2 s.e." if self.bars == 2 and self.marker else ""
        return (self.brief or reader_words(self.name)) + errors


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves over one axis; ``x`` and ``y`` are the words of the axes with their units.

    ``floor``: values below it are not resolved; ``marks``: horizontal levels with their words.
    ``logarithmic`` is the scale of the x axis. ``limits`` are the ends of the y axis, None for ends
    by the values. A linear y axis begins with 0 if ``zero``; a logarithmic y axis ends at the share
    ``lowest`` of the largest value, if that is not 0. ``stops`` are the places of stops on the x
    axis; beyond the only stop of a side the panel is shaded. ``by_x``: the lines give the ends of
    the x axis, and a reader of the page asks for all curves at one x; else for the nearest point.
    """

    title: str
    x: str
    y: str
    curves: Sequence[Curve]
    floor: float | None = None
    marks: Sequence[tuple[float, str]] = ()
    logarithmic: bool = True
    limits: tuple[float, float] | None = None
    y_logarithmic: bool = True
    by_x: bool = False
    zero: bool = False
    lowest: float = 0.0
    stops: Sequence[float] = ()

    def styled(self) -> list[tuple[Curve, str, str, Array]]:
        """Return every curve, its colour, key of its marker or "", and values y (points,) drawn.

        On a logarithmic y axis without ``lowest`` these are at least ``EPS``.
        """
        rows = []
        for curve, colour, marker in zip(self.curves, cycle(COLOURS), cycle(MARKERS), strict=False):
            own = marker if curve.marker is None else curve.marker
            y = np.asarray(curve.y, dtype=float)
            if self.y_logarithmic and not self.lowest:
                y = np.maximum(y, EPS)  # where an error of exactly 0 is drawn
            rows.append((curve, curve.colour or colour, own, y))
        return rows

    def levels(self) -> list[Record]:
        """Return ``marks`` and ``floor`` as records ``y``, ``words``, ``fill`` (shaded below)."""
        levels: list[Record] = [{"y": y, "words": words, "fill": False} for y, words in self.marks]
        floor = {"y": self.floor, "words": "floor: error of the reference", "fill": True}
        return levels + ([floor] if self.floor is not None else [])

    @property
    def groups(self) -> list[str]:
        """The groups of the curves shown, each once."""
        return list(dict.fromkeys(curve.group for curve in self.curves if curve.shown))

    def shaded(self) -> list[tuple[float, float]]:
        """Return the intervals beyond the only stop of a side; their outer ends are infinite."""
        left, right = ([s for s in self.stops if np.signbit(s) == side] for side in (True, False))
        intervals = [(-np.inf, stop) for stop in left] if len(left) == 1 else []
        return intervals + ([(stop, np.inf) for stop in right] if len(right) == 1 else [])

    def record(self, **more: Any) -> Record:
        """Return the data of a plot for the page's script; ``more`` adds or replaces keys."""
        x, series = self.shared_x(), []
        for curve, colour, marker, y in self.styled():
            own = {key: getattr(curve, key) for key in ("shown", "notes", "band", "form")}
            own |= {"curve": curve.group, "name": reader_words(curve.name), "guide": curve.dashed}
            own |= {"colour": colour, **round_values(y=y, error=curve.bar)}
            own |= {} if curve.bar is None else {"bars": curve.bars}
            own |= {"marks": MARKERS[marker]} if marker else {}
            own |= {} if curve.style == "none" else {"dash": DASHES[curve.style]}
            own["x"] = None if curve.form or np.array_equal(curve.x, x) else curve.x
            series.append(own)
        keys = "title", "zero", "lowest", "stops", "limits"
        return {
            **{key: getattr(self, key) for key in keys},
            **{
                "xlabel": self.x,
                "ylabel": self.y,
                "xlog": self.logarithmic,
                "levels": self.levels(),
            },
            **{"scales": [self.y_logarithmic], "shaded": self.shaded(), "x": x if x.size else None},
            "series": series,
            **more,
        }

    def coincidences(self) -> list[str]:
        """Return sentences on lines that are nowhere further apart than the width of a line."""
        scale = np.log if self.y_logarithmic else np.asarray
        drawn = [row for row in self.styled() if row[0].shown and len(row[0].y)]
        lines = [(c, scale(y)) for c, _, _, y in drawn if c.style != "none"]
        ends = [v for _, y in lines for v in (np.nanmin(y), np.nanmax(y), *[0.0] * self.zero)]
        width = SAME_LINE * (max(ends) - min(ends)) if ends else 0.0

        def coincide(a: tuple[Curve, Array], b: tuple[Curve, Array]) -> bool:
            return np.array_equal(a[0].x, b[0].x) and bool(np.all(np.abs(a[1] - b[1]) <= width))

        notes = []
        while lines:
            first, *others = lines
            lines = [line for line in others if not coincide(first, line)]
            if len(lines) == len(others):
                continue
            groups: dict[str, list[str]] = {}
            for curve, _ in (first, *(line for line in others if coincide(first, line))):
                groups.setdefault(curve.brief or reader_words(curve.name), []).append(curve.group)
            words = [f"{n} ({', '.join(of)})" if any(of) else n for n, of in groups.items()]
            notes.append(f"the lines of {' and '.join(words)} coincide")
        return notes

    def shared_x(self) -> Array:
        """Return the x of all lines, or of all curves if none is a line, each once, ascending.

        Empty unless ``by_x``.
        """
        lines = [c for c in self.curves if c.style != "none" and not c.form] or self.curves
        every = [np.asarray(c.x, dtype=float) for c in lines if self.by_x]
        return np.unique(np.concatenate(every)) if every else np.zeros(0)


@dataclass(frozen=True, eq=False)
class Field:
    """A map of ``values`` (x, y), NaN for a missing value, with their ``errors``, over two axes.

    Values run between ``limits``; None: between the smallest and the largest. With ``categories``,
    words and colours, they are the indices of these. ``split`` (x, y) is True on one side of a
    border that is drawn, which ``border`` names. ``smooth``: the page interpolates between the
    points, else it shows cells around them. ``lowest`` is the share of the largest value at which a
    logarithmic scale ends. ``stops`` are the places of stops on either axis. A field that is not
    ``shown`` appears in the page on demand. ``brief`` is the title over contours, if another.
    """

    title: str
    x: Axis
    y: Axis
    values: Array
    errors: Array | None = None
    logarithmic: bool = False
    limits: tuple[float, float] | None = None
    categories: tuple[tuple[str, str], ...] = ()
    split: Any = None
    border: str = ""
    smooth: bool = False
    lowest: float = 0.0
    stops: tuple[Sequence[float], Sequence[float]] = ((), ())
    shown: bool = True
    brief: str = ""

    def record(self) -> Record:
        """Return the data of a field in a plot for the page's script."""
        given = self.values[np.isfinite(self.values)]
        low, high = self.limits or ((given.min(), given.max()) if given.size else (0.0, 1.0))
        error = None if self.errors is None else self.errors.ravel()
        words, colours = zip(*self.categories, strict=True) if self.categories else ((), ())
        return {
            **{"name": self.title, "shown": self.shown, "log": self.logarithmic},
            **{"smooth": self.smooth, "x": self.x.values, "y": self.y.values},
            **round_values(z=self.values.ravel(), error=error),
            **{"low": low, "high": high if high > low else low + (abs(low) or 1.0)},
            "floor": self.lowest * high or max(low, 0.0),
            **({"names": words, "colours": colours} if words else {}),
        }


def map_record(fields: Sequence[Field], **more: Any) -> Record:
    """Return the data of a plot with a map of each field for the page's script.

    The first field gives the axes, stops and border; ``more`` adds or replaces keys.
    """
    first = fields[0]
    own = [field.record() for field in fields]
    for record, field in zip(own, fields, strict=True):
        for key, common in (("x", first.x), ("y", first.y)):
            if getattr(field, key) is common:
                del record[key]
    return {
        **{"x": first.x.values, "xlog": first.x.logarithmic, "xlabel": first.x.label},
        **{"y": first.y.values, "ylog": first.y.logarithmic, "ylabel": first.y.label},
        "stops": first.stops,
        "split": None if first.split is None else first.split.astype(int).ravel(),
        "border": first.border,
        "fields": own,
        **more,
    }


def live_plots(panels: Sequence[Panel | Field], still: str) -> list[Record]:
    """Return the data of the page's plots: first one for each panel, then one for all fields.

    ``still`` is the id of the figure that they replace; their ids are ``still_0`` and so on.
    """
    fields = [panel for panel in panels if isinstance(panel, Field)]
    plots = [panel.record() for panel in panels if isinstance(panel, Panel)]
    plots += [map_record(fields)] if fields else []
    return [{"id": f"{still}_{k}", "still": [still], **plot} for k, plot in enumerate(plots)]


def spans_decades(values: Any) -> bool:
    """Whether all finite ``values`` are > 0 and the largest is > ``DECADES`` times the smallest."""
    given = values[np.isfinite(values)]
    return bool(given.size and given.min() > 0.0 and given.max() > DECADES * given.min())


def curves_over(axis: Axis, names: Sequence[str], values: Any, errors: Any) -> list[Curve]:
    """Return a curve for each of ``names`` with its row of ``values`` and ``errors``.

    Both are (names, points); rows without a finite value are left out.
    """
    rows = zip(names, values, errors, strict=True)
    return [Curve(name, axis.values, y, bar) for name, y, bar in rows if np.isfinite(y).any()]
