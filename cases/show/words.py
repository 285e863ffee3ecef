"""Names of theories and routes, and effects, in words for readers."""

import re
from collections.abc import Mapping
from typing import Any

from fpk.answer.method import ROUTES, Route
from fpk.system.system import System

KEYS = re.compile(
    r"(?<![\w-])(?<!--method )(?<!--route )((?:non)?integrable|phase-space|montecarlo)(/[\w-]+)?\b"
)
"""Pattern of keys of methods that have another name for readers, and of labels of their routes."""

CONSTANT_NOISE = (
    "The noise is modulated: quantities, densities and averaging errors that are not in time are"
    " those of the stationary state under constant noise, e = 1, which this motion need not reach."
)
"""Note on stationary numbers of a scene whose noise is not stationary."""


def stationary_note(system: System) -> str:
    """Return ``CONSTANT_NOISE`` if the noise of ``system`` is modulated, else an empty text."""
    return CONSTANT_NOISE if system.modulation is not None else ""


def reader_words(text: str) -> str:
    """Return ``text`` with the labels of routes and the keys of methods in words for readers.

    Keys behind ``--method`` and ``--route``, which are typed, stay.
    """
    if route := _routes().get(text):
        return route.words

    def words(key: re.Match[str]) -> str:
        route = _routes().get(key[0])
        return route.words if key[2] and route else theory_of_route(key[1]) + (key[2] or "")

    return KEYS.sub(words, text)


def theory_of_route(label: str) -> str:
    """Return the theory's name for a route's ``label`` or a method's key, else ``label`` itself."""
    ordered = sorted(ROUTES.values(), key=lambda route: not route.sampled)
    first = {route.method: route for route in ordered}  # of a method that of one that solves
    route = _routes().get(label) or first.get(label)
    return route.name if route else label


def with_key(method: str) -> str:
    """Return the name of a method, and behind it in brackets its key if that is another word."""
    name = theory_of_route(method)
    return name if name == method else f"{name} ({method})"


def effects_in_words(effects: Mapping[str, Any]) -> str:
    """Return the entry ``effects`` of ``facts_record`` as one line of words."""
    masses, stops, rank = (effects[key] for key in ("masses", "stops", "noise_rank"))
    where = ", ".join(map(str, effects["contact_masses"]))
    parts = [
        _count(masses, "mass", "es"),
        f"{_count(stops, 'stop')} on mass {where} ({', '.join(effects['laws'])} law)"
        if stops
        else "no stops",
        _count(rank, "independent noise") + (", correlated" * effects["correlated_noise"]),
    ]
    parts += ["damping that couples masses"] if effects["coupled_damping"] else []
    on = "state and the energy" if effects["energy_damping"] else "state"
    parts += [f"damping that depends on the {on}"] if effects["state_damping"] else []
    return "; ".join([*parts, "mirror symmetric" if effects["mirror"] else "not mirror symmetric"])


def _count(number: int, noun: str, plural: str = "s") -> str:
    return f"{number or 'no'} {noun}{plural if number != 1 else ''}"


def _routes() -> dict[str, Route]:
    return {route.label: route for route in ROUTES.values()}
