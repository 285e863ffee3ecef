"""Scenes: one system, what is observed of it, and the further curves of its figure."""

from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from cases.scene.errors import BadInput, refused, shortened, toml_value
from cases.scene.expect import Expect, expect_of
from cases.scene.reading import read_toml
from cases.scene.schema import ContactTable, DampingTermTable, SceneTable, validated
from cases.scene.vary import Curve, curves_of
from fpk.contact import Contact
from fpk.damping import DampingTerm
from fpk.errors import InvalidInput
from fpk.observable import Observable, parse_observable
from fpk.system import System

SHIPPED = ("paper", "hard", "more")
"""The folders of the shipped scenes, in the order in which they are listed."""

LONGEST_NAME = 200
"""Characters of a path in messages."""


@dataclass(frozen=True)
class Scene:
    """A checked scene file.

    ``name`` is the file's stem; ``text`` the file as it was read; ``curves`` holds the scene's own
    system first, then those that ``[vary]`` adds.
    """

    name: str
    title: str
    source: str
    text: str
    system: System
    observables: tuple[Observable, ...]
    curves: tuple[Curve, ...]
    expect: Expect | None = None


def shipped_scenes() -> dict[str, Path]:
    """Return the shipped scenes: name to path."""
    here = Path(__file__).parents[1]
    return {path.stem: path for folder in SHIPPED for path in sorted(here.glob(f"{folder}/*.toml"))}


def load_scene(name: str) -> Scene:
    """Return the shipped scene of that name, or the one in the file at that path.

    Raises ``BadInput``: one line that names file, key, value and what would be right.
    """
    if not name.strip():
        raise BadInput(f"scene {toml_value(name)}: is no name; fpk list names the shipped scenes")
    shipped = shipped_scenes()
    if name in shipped:
        return _scene(shipped[name], f"{name}.toml")
    path = Path(name)
    looks_like_path = path.suffix or len(path.parts) > 1
    if not looks_like_path and not _exists(path):
        close = get_close_matches(name, shipped, n=1)
        hint = f'did you mean "{close[0]}"?' if close else "fpk list names the shipped scenes"
        raise BadInput(f"scene {toml_value(name)}: neither a shipped scene nor a file; {hint}")
    return _scene(path, shortened(name, LONGEST_NAME))


def _exists(path: Path) -> bool:
    try:
        return path.exists() or path.is_symlink()
    except (OSError, ValueError):
        return False


def _scene(path: Path, label: str) -> Scene:
    data, text = read_toml(path, label)
    table = validated(data, label)
    system = _system(table, label)
    observables = _observables(table, system, label)
    curves = curves_of(system, table.vary, label)
    return Scene(
        name=path.stem,
        title=table.title or path.stem,
        source=table.source,
        text=text,
        system=system,
        observables=observables,
        curves=curves,
        expect=expect_of(table.expect, observables, curves, label),
    )


def _system(table: SceneTable, label: str) -> System:
    contacts = tuple(_contact(c, i, label) for i, c in enumerate(table.contact))
    terms = tuple(
        _damping_term(t, i, label, n=len(table.system.mass))
        for i, t in enumerate(table.damping_term)
    )
    s: Any = table.system  # System takes lists and matrices and checks them
    try:
        system = System(
            s.mass, s.stiffness, s.damping, s.noise_intensity, s.noise_gain, damping_terms=terms
        )
    except InvalidInput as error:
        raise refused(label, f"system.{error.key}", error.value, error.remedy) from None
    for i, contact in enumerate(contacts):
        if contact.mass > system.n:
            raise refused(
                label,
                f"contact[{i + 1}].mass",
                contact.mass,
                f"is not a mass; use 1 to {system.n}",
            )
    return replace(system, contacts=contacts)


def _contact(table: ContactTable, index: int, label: str) -> Contact:
    try:
        return Contact(
            mass=table.mass,
            side=table.side,  # type: ignore[arg-type]  # Contact checks it
            stiffness=table.stiffness,
            clearance=table.clearance,
            law=table.law,
            exponent=table.exponent,
        )
    except InvalidInput as error:
        key = f"contact[{index + 1}].{error.key}"
        if error.value is None:
            raise BadInput(f"{label}: {key} is missing: {error.remedy}") from None
        raise refused(label, key, error.value, error.remedy) from None


def _damping_term(table: DampingTermTable, index: int, label: str, *, n: int) -> DampingTerm:
    place = f"damping_term[{index + 1}]"
    for key in ("i", "j"):
        if (mass := getattr(table, key)) > n:
            raise refused(label, f"{place}.{key}", mass, f"is not a mass; use 1 to {n}")
    powers = {key: _powers(getattr(table, key), f"{place}.{key}", label, n) for key in ("q", "v")}
    try:
        return DampingTerm(table.i, table.j, table.coefficient, **powers, energy=table.energy)
    except InvalidInput as error:
        key = place if error.key == "damping_term" else f"{place}.{error.key}"
        raise refused(label, key, error.value, error.remedy) from None


def _powers(table: dict[str, int], place: str, label: str, n: int) -> tuple[tuple[int, int], ...]:
    masses = {str(mass): mass for mass in range(1, n + 1)}
    for name, power in table.items():
        if name not in masses:
            raise refused(label, f"{place}.{name}", power, f"is not a mass; use 1 to {n}")
    return tuple((masses[name], power) for name, power in table.items())


def _observables(table: SceneTable, system: System, label: str) -> tuple[Observable, ...]:
    if table.observe is None:
        touching = system.contact_masses or (system.n - 1,)
        names = [*(f"q{i + 1}" for i in touching[:15]), "H"]
        return tuple(parse_observable(name, system.n) for name in names)
    observables: list[Observable] = []
    for i, name in enumerate(table.observe.densities):
        key = f"observe.densities[{i + 1}]"
        try:
            observable = parse_observable(name, system.n)
        except InvalidInput as error:
            raise refused(label, key, name, error.remedy) from None
        if observable in observables:
            raise refused(label, key, name, "is asked for twice; leave one out")
        observables.append(observable)
    return tuple(observables)
