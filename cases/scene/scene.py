"""Scenes: read from a file; one system, what is observed of it, and the curves of its figure."""

import re
import stat
import tomllib
from dataclasses import dataclass
from os.path import lexists
from pathlib import Path
from typing import Any

from cases.scene.errors import BadInput, about_key, misspelt, readable_errors, toml_value
from cases.scene.expect import Expect, expect_of
from cases.scene.numbers import Curve, curves_of
from cases.scene.questions import PassageQuestion, TransientQuestion, passages_of, transients_of
from cases.scene.schema import validate_scene
from cases.scene.units import NO_UNITS, Units
from fpk.answer.names import Level, Observable, parse_observable
from fpk.numeric.errors import InvalidInput, require
from fpk.system.system import System

MAX_BYTES = 1 << 20
"""Largest size of a scene file in bytes."""

MAX_DEPTH = 16
"""Largest depth of tables and lists, and number of parts of a dotted key; a scene needs five. Some
hundreds exhaust the stack, and the parser takes a time of n² for a key of n parts."""

NO_KEY = re.compile(
    r""""{3}(?:\\.?|[^\\])*?(?:"{3}|\Z) | '{3}.*?(?:'{3}|\Z)
      | "(?:\\.|[^"\\\n])*+"? | '[^'\n]*+'? | \#[^\n]* | \d\.\d""",
    re.VERBOSE | re.DOTALL,
)
"""Matches texts, comments and decimal points of TOML; all other dots belong to dotted keys."""


def read_toml(path: Path, label: str) -> tuple[dict[str, Any], str]:
    """Return the tables of the TOML file at ``path`` and its text, without a byte order mark.

    ``label`` names the file in messages. Raises ``BadInput`` with one line if the file cannot be
    read, is empty, is not TOML, or is nested too deeply.
    """
    text = read_text(path, label, most=MAX_BYTES, what="a scene").removeprefix("\ufeff")
    if not text.strip():
        raise BadInput(f"{label}: the file is empty; a scene needs at least the table [system]")
    too_deep = BadInput(f"{label}: nested too deeply; a scene has at most {MAX_DEPTH} levels")
    if any(line.count(".") > MAX_DEPTH for line in NO_KEY.sub("", text).splitlines()):
        raise too_deep
    try:
        tables = tomllib.loads(text)
        depth = _depth(tables)
    except RecursionError:
        raise too_deep from None
    except ValueError as error:  # TOMLDecodeError and numbers of thousands of digits
        raise BadInput(f"{label}: is not valid TOML: {error}; correct it there") from None
    if depth > MAX_DEPTH:
        raise too_deep
    return tables, text


def read_text(path: Path, label: str, *, most: int, what: str) -> str:
    """Return the UTF-8 text of a regular file of at most ``most`` bytes.

    ``what`` names the expected content in messages, as "a scene". Raises ``BadInput`` with one line
    that begins with ``label`` for a file that is missing, unreadable, larger or not UTF-8, and for
    a folder, a pipe or a device.
    """
    with readable_errors(label, "cannot be read", "give another file"):
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            raise BadInput(f"{label}: is a folder; {what} is a file in it")
        if not stat.S_ISREG(mode):
            raise BadInput(f"{label}: is not a regular file; {what} is one")
        with path.open("rb") as stream:
            content = stream.read(most + 1)
    if len(content) > most:
        few = f"{what} has at most {most} ({most >> 20} MiB)"
        raise BadInput(f"{label}: has more than {most} bytes; {few}")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise BadInput(
            f"{label}: is not UTF-8 text: byte 0x{content[error.start]:02x} at position"
            f" {error.start}; save the file as UTF-8"
        ) from None


def _depth(value: Any) -> int:
    """Return how deep tables and lists are nested: 1 for a flat list, 0 for a number or text."""
    if not isinstance(value, (dict, list)):
        return 0
    return 1 + max(map(_depth, value.values() if isinstance(value, dict) else value), default=0)


SHIPPED = ("paper", "hard", "more", "time")
"""The folders of the shipped scenes, in the order in which they are listed."""


@dataclass(frozen=True)
class Scene:
    """A checked scene file.

    ``name`` is the file's stem, also the ``title`` if the file has none; ``source`` says where the
    values come from, empty if the file does not; ``text`` is the content of the file; ``curves``
    holds the scene's own system first, then the curves of ``[vary]``. ``expect``: the claims, None
    for none. ``passages`` and ``transients`` are the questions in time, for each curve.
    ``exceedance`` has pairs (X, a): an observable and a level of P(X > a). ``units`` are the names
    of ``[units]``.
    ``densities_asked``: ``observables`` come from ``[observe]``, not from the defaults. ::

        scene = fpk.load("fig6a")
        scene.title, scene.system, [(curve.label, curve.value) for curve in scene.curves]
    """

    name: str
    title: str
    source: str
    text: str
    system: System
    observables: tuple[Observable, ...]
    curves: tuple[Curve, ...]
    expect: Expect | None = None
    passages: tuple[PassageQuestion, ...] = ()
    transients: tuple[TransientQuestion, ...] = ()
    units: Units = NO_UNITS
    exceedance: tuple[Level, ...] = ()
    densities_asked: bool = False


def shipped_scenes() -> dict[str, Path]:
    """Return the paths of the shipped scenes by their names.

    ::

        sorted(shipped_scenes())
    """
    here = Path(__file__).parents[1]
    return {path.stem: path for folder in SHIPPED for path in sorted(here.glob(f"{folder}/*.toml"))}


def load_scene(scene: str | Path) -> Scene:
    """Return the shipped scene of the name ``scene``, or the scene at that path.

    Its ``system`` is Eq. (1). A path has a folder or a suffix, as ``"my/pipe.toml"``,
    or names something that exists. ::

        system = fpk.load("fig6a").system

    Raises ``BadInput``: one line that names file, key, value and what would be right.
    """
    name, shipped = str(scene), shipped_scenes()
    if name in shipped:
        return _scene(shipped[name], f"{name}.toml")
    path = Path(name)
    looks_like_path = path.suffix or len(path.parts) > 1
    if not looks_like_path and not lexists(name):
        near = misspelt(name, shipped)
        hint = f'did you mean "{near}"?' if near else "fpk list names the shipped scenes"
        raise BadInput(f"scene {toml_value(name)}: neither a shipped scene nor a file; {hint}")
    return _scene(path, name)


def _scene(path: Path, label: str) -> Scene:
    data, text = read_toml(path, label)
    try:
        tables = validate_scene(data)
        system = _system(tables)
        observe = tables.get("observe", {})
        observables = _observables(observe.get("densities"), system)
        exceedance = _exceedance(observe.get("exceedance", {}), observables, system)
        curves = curves_of(system, tables.get("vary"))
        expect = expect_of(tables.get("expect"), observables, curves=len(curves))
        passages = passages_of(tables.get("passage", ()), system)
        transients = transients_of(tables.get("transient", ()), system)
    except InvalidInput as error:
        given = "is missing" if error.value is None else f"= {toml_value(error.value)}"
        raise BadInput(f"{label}: {error.key or 'scene'} {given}: {error.remedy}") from None
    title, source = tables.get("title") or path.stem, tables.get("source", "")
    asked = observables, curves, expect, passages, transients
    return Scene(
        path.stem, title, source, text, system, *asked, units=tables.get("units", NO_UNITS),
        exceedance=exceedance, densities_asked="densities" in observe,
    )  # fmt: skip


def _system(tables: dict[str, Any]) -> System:
    contacts, terms = (tuple(tables.get(key, ())) for key in ("contact", "damping_term"))
    try:
        return System(
            **tables["system"],
            contacts=contacts,
            damping_terms=terms,
            modulation=tables.get("modulation"),
        )
    except InvalidInput as error:
        place = "system." if error.key in tables["system"] else ""
        raise InvalidInput(place + error.key, error.value, error.remedy) from None


def _observables(densities: list[str] | None, system: System) -> tuple[Observable, ...]:
    if densities is None:
        touching = system.contact_masses or (system.n - 1,)
        names = [*(f"q{i + 1}" for i in touching[:15]), "H"]
        return tuple(parse_observable(name, system.n) for name in names)
    observables: list[Observable] = []
    for k, name in enumerate(densities, start=1):
        with about_key(f"observe.densities[{k}]", name):
            observable = parse_observable(name, system.n)
        if observable in observables:
            raise InvalidInput(f"observe.densities[{k}]", name, "is asked for twice; leave one out")
        observables.append(observable)
    return tuple(observables)


def _exceedance(
    table: dict[str, list[float]], observables: tuple[Observable, ...], system: System
) -> tuple[Level, ...]:
    key = "observe.exceedance"
    levels: list[Level] = []
    for name, values in table.items():
        with about_key(key, name):
            observable = parse_observable(name, system.n)
        require(len(observable) == 1, key, name, "is a pair; name one coordinate")
        if observable not in observables:
            raise InvalidInput(key, name, "is not observed; add it to observe.densities")
        for k, value in enumerate(values, start=1):
            if (observable, value) in levels:
                raise InvalidInput(f"{key}.{name}[{k}]", value, "is asked for twice; leave one out")
            levels.append((observable, value))
    return tuple(levels)
