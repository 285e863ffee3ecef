"""Names of theories and routes for readers, who do not know those of the command line."""

import re

from fpk.route import ROUTES, Route

AVERAGED = re.compile(r"(?<![\w-])(non)?integrable\b")
"""Theories that have another name on the command line than for readers."""


def named(text: str) -> str:
    """Return a route's words for its label; in other text theories by their names for readers."""
    if route := _routes().get(text):
        return route.words
    names = {route.method: route.name for route in ROUTES.values() if not route.sampled}
    return AVERAGED.sub(lambda word: names.get(word[0], word[0]), text)


def theory_of_route(label: str) -> str:
    """Return the name of a route's theory, the label itself of one that is not known."""
    route = _routes().get(label)
    return route.name if route else label


def _routes() -> dict[str, Route]:
    return {route.label: route for route in ROUTES.values()}
