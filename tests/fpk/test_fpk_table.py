"""Tables of joint densities: their stated error holds, and none is used that is not good enough."""

from collections.abc import Callable

import numpy as np
import pytest

from fpk.answer.certificate import Measured
from fpk.answer.density import Density, certified_density, l1_distance
from fpk.answer.observable import parse_observable
from fpk.numeric.arrays import Array
from fpk.numeric.quadrature import gauss_grid, integral

NODES = np.linspace(-8.0, 8.0, 17)


def joint(pdf: Callable[..., Array], l1_error: float, calls: list[int] | None = None) -> Density:
    def counted(x: Array, y: Array) -> Array:
        if calls is not None:
            calls.append(np.broadcast(x, y).size)
        return pdf(x, y)

    return certified_density(
        parse_observable("q1,p1", 1), (NODES, NODES), counted, lambda x, y: 0.0 * pdf(x, y),
        measured=Measured(l1_error, 0.0, 0.0, 0.0, 0.0), tol=1.0,
    )  # fmt: skip


def gaussian(x: Array, y: Array) -> Array:
    return np.asarray(np.exp(-0.5 * (x * x + y * y)) / (2.0 * np.pi))


def rough(x: Array, y: Array) -> Array:
    """A density with a kink across the panels."""
    return np.asarray(gaussian(x, y) * (1.0 + 0.1 * np.abs(np.sin(x + y))))


@pytest.mark.parametrize(("pdf", "allowed"), [(gaussian, 1e-10), (rough, 1e-2)])
def test_the_error_of_a_table_is_stated(pdf: Callable[..., Array], allowed: float) -> None:
    density = joint(pdf, allowed)
    assert density.table is not None and 0.0 < density.table_error <= allowed
    mesh, grids = gauss_grid([np.linspace(-8.0, 8.0, 60)] * 2)
    distance = integral(np.abs(density.tabulated(*mesh) - pdf(*mesh)), grids)
    assert 0.05 * density.table_error < distance < density.table_error


def test_no_table_that_is_worse_than_the_density() -> None:
    assert joint(rough, 1e-10).table is None
    x = np.array([0.3])
    assert joint(rough, 1e-10).tabulated(x, x) == rough(x, x)


def test_comparing_does_not_evaluate_again() -> None:
    calls: list[int] = []
    first, second = joint(gaussian, 1e-10, calls), joint(gaussian, 1e-10, calls)
    made = len(calls)
    assert l1_distance(first, second) == 0.0
    edges = np.linspace(-4.0, 4.0, 33)
    assert first.cell_averages(edges, edges).sum() * 0.25**2 == pytest.approx(1.0, rel=2e-4)
    assert len(calls) == made
