"""Routes: every way from a system to densities that the program offers, in one registry."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from fpk.method import Method

Solves = Literal["full", "averaged"]


@dataclass(frozen=True)
class Route:
    """One METHOD with one SOLVER of the command line, and all that others need to know of it.

    ``method`` and ``solver`` are the names on the command line; ``words`` says for legends what is
    solved and how, ``equation`` the number of the paper's equation. ``solves`` is "full" for
    Eq. (6) itself and "averaged" for a theory's equation; ``sampled`` says that the errors are
    those of sampling. ``colour`` is the curve's (#rrggbb). ``make()`` returns the method with its
    default settings. ``quick``: an answer does not take seconds, so that ``fpk export`` and the
    references of studies take the route without being told. ``named``: it is taken only where its
    solver is named.
    Of one method's routes the one registered first is the default and the one that is drawn; a
    route that samples comes after those that do not.
    """

    method: str
    solver: str
    words: str
    equation: str
    solves: Solves
    sampled: bool
    colour: str
    make: Callable[[], "Method"]
    quick: bool = True
    named: bool = False

    @property
    def name(self) -> str:
        """Name for readers: the theory's alone, that of a simulated theory in full."""
        return self.words if self.sampled else self.words.partition(",")[0]

    @property
    def label(self) -> str:
        """Name in tables: the method's own where it has one solver, else method/solver."""
        alone = len(solvers_of(self.method)) <= 1
        return self.method if alone else f"{self.method}/{self.solver}"


ROUTES: dict[tuple[str, str], Route] = {}
"""Every route by (method, solver), in the order of registration."""


def register(route: Route) -> Route:
    """Add a route to the registry and return it; a pair of names is taken once."""
    key = route.method, route.solver
    if key in ROUTES:
        raise ValueError(f"route {route.method}/{route.solver} is registered already")
    ROUTES[key] = route
    return route


def solvers_of(method: str) -> tuple[str, ...]:
    """Return the solvers of a method, its default first and those that sample last."""
    own = [route for route in ROUTES.values() if route.method == method]
    return tuple(route.solver for route in sorted(own, key=lambda route: route.sampled))


def methods() -> tuple[str, ...]:
    """Return the names of all methods, in the order of registration."""
    return tuple(dict.fromkeys(name for name, _ in ROUTES))
