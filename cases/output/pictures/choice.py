"""Which answers of a curve are drawn: lines, samples, two solvers of one equation."""

from itertools import combinations

from cases.comparison.answers import Answers
from fpk.arrays import Array
from fpk.density import Density
from fpk.observable import Observable
from fpk.route import Route
from fpk.sampled_density import SampledDensity


def lines_of(curve: Answers, observable: Observable) -> dict[Route, Density]:
    """Return the densities drawn as lines: an exact one, and of each averaged method its first.

    An averaged method that is exact itself is not drawn beside the exact density.
    """
    drawn: dict[str, tuple[Route, Density]] = {}
    for route, density in curve.densities(observable).items():
        full = route.solves == "full"
        if isinstance(density, Density) and (full or "" not in drawn or not curve.is_exact(route)):
            drawn.setdefault("" if full else route.method, (route, density))
    return dict(drawn.values())


def samples_of(curve: Answers, observable: Observable) -> dict[Route, SampledDensity]:
    """Return the histograms of one observable, that of the full system first."""
    densities = curve.densities(observable).items()
    return {route: d for route, d in densities if isinstance(d, SampledDensity)}


Differences = tuple[Array, Array, dict[str, Array]]
"""Points along the first axis, the band in which differences of two answers may lie, and these."""


def solver_difference(curve: Answers, observable: Observable, *points: Array) -> Differences | None:
    """Return how far two solvers of one averaged equation differ; the band is what both state.

    None where no equation has two deterministic answers. The one that states the larger error comes
    first.
    """
    answers = curve.densities(observable).items()
    functions = [(r, d) for r, d in answers if r.solves == "averaged" and isinstance(d, Density)]
    for pair in combinations(functions, 2):
        (a, first), (b, second) = sorted(pair, key=lambda answer: -answer[1].l1_error)
        if a.method == b.method:
            (value, stated), (other, also_stated) = first.at(*points), second.at(*points)
            return points[0], stated + also_stated, {f"{a.solver} − {b.solver}": value - other}
    return None
