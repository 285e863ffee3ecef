"""Links of the reference of Python: to the equation that a name computes, and to the gallery.

A section of ``theory.md`` or ``glossary.md`` with a label, as ``(first-passage)=``, is linked from
every name that it mentions as ``path::name``, a class with its members; "Eq. (n)" in a docstring is
a link of its own. Examples are those in which sphinx-gallery saw the name.
"""

import re
from functools import cache
from pathlib import Path

DOCS = Path(__file__).parent
PAGES = ("theory.md", "glossary.md")
SECTION = re.compile(r"^\((\S+)\)=\n#+ (.*)$", re.MULTILINE)
MENTION = re.compile(r"`([a-z_0-9/]+\.py::[\w.]+)`")
EQUATION = re.compile(r"(Eqs?\. \((\d+)\))")
SECTIONS = {
    "system": range(1, 7),
    "exact": range(7, 9),
    "one-energy": (*range(9, 12), *range(24, 31)),
    "modal-energies": (*range(12, 21), *range(31, 37)),
}
"""Sections of the theory by the equations of the paper."""
MOST_EXAMPLES = 5
"""Links to the gallery at one name."""
COMPUTING = ("fpk", "averaging", "sim")
"""Rooms whose names stand for something that the theory or the glossary defines."""


def with_equations(text: str) -> str:
    """Return ``text`` with its equations as links."""
    section = {n: name for name, numbers in SECTIONS.items() for n in numbers}
    return EQUATION.sub(lambda m: f":ref:`{m[1]} <{section[int(m[2])]}>`", text)


@cache
def mentions() -> dict[str, dict[str, str]]:
    """Return the titles of sections by label, for each ``path::name`` that they mention."""
    found: dict[str, dict[str, str]] = {}
    for page in PAGES:
        _, *parts = SECTION.split((DOCS / page).read_text(encoding="utf-8"))
        for label, title, text in zip(*[iter(parts)] * 3, strict=True):
            own = re.split(r"^## ", text, maxsplit=1, flags=re.MULTILINE)[0]
            for name in MENTION.findall(own):
                found.setdefault(name, {})[label] = title.partition(", (")[0].partition(":")[0]
    return found


def defined(obj: object) -> str:
    """Return where a class, function or property is defined, as ``path::name``; empty if nowhere.

    An inherited member is that of the class which defines it.
    """
    obj = getattr(obj, "fget", None) or getattr(obj, "func", obj)
    module, name = (getattr(obj, key, None) for key in ("__module__", "__qualname__"))
    return f"{module.replace('.', '/')}.py::{name}" if module and name else ""


def theory_of(name: str, obj: object) -> dict[str, str]:
    """Return the sections that define ``obj``, documented as ``name``: titles by label.

    Of an inherited member they are the sections of the class that defines it; other members have
    those at their class already.
    """
    place, (*_, owner, _) = defined(obj), name.split(".")
    of = place.rpartition(".")[0]
    return mentions().get(place) or ({} if of.endswith(f"::{owner}") else mentions().get(of, {}))


def gallery_of(name: str, source: Path) -> list[str]:
    """Return the pages of examples that use ``name``; ``source`` is the folder of the site."""
    used = source / "gallery" / "backreferences" / f"{name}.examples"
    shown = used.read_text(encoding="utf-8") if used.exists() else ""
    return list(dict.fromkeys(re.findall(r":doc:`(/gallery/\w+)`", shown)))


def links_of(what: str, name: str, obj: object, text: str, source: Path) -> tuple[str, str]:
    """Return the line of links of a name, and what is missing of them, in words.

    A class, function or exception has an example in the gallery; but for exceptions, and for what
    belongs to scenes and files, it has an equation or a section. ``text`` is its docstring.
    """
    entry = what in ("class", "function", "exception")
    theory = theory_of(name, obj)
    pages = gallery_of(name, source)
    parts = ["See: " + ", ".join(f":ref:`{t} <{label}>`" for label, t in theory.items())]
    parts += ["In the gallery: " + ", ".join(f":doc:`{p}`" for p in pages[:MOST_EXAMPLES])]
    line = ". ".join(part for part in parts if part[-2:] != ": ")
    room = getattr(obj, "__module__", "").partition(".")[0]
    missing = ["no example in the gallery"] if entry and not pages else []
    if what in ("class", "function") and room in COMPUTING:
        missing += [] if theory or EQUATION.search(text) else ["no equation and no section"]
    return line, " and ".join(missing)
