"""Compiled arithmetic of two energies, and fits of rising degree, against plain NumPy."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from test_fpk_plane import manufactured

from fpk.errors import NotCertified
from fpk.plane.mesh import probed
from fpk.plane.pointwise import evaluated, flux_free_slopes, seen_points, weighted_on_grid
from fpk.plane.polynomials import fits, grid_of, of_total_degree, values_at
from fpk.process import Process

PROCESS, LOG_P = manufactured(0.4, 0.2)
X, Y = np.linspace(0.1, 3.0, 7), np.linspace(0.2, 2.0, 5)


def test_coefficients_on_the_grid_are_those_of_their_formulas() -> None:
    random = np.random.default_rng(11)
    phi, first, second, area = random.uniform(0.0, 5.0, (4, 7, 5))
    seen = phi < 3.0
    w, H = seen_points(X, Y, seen, phi, area)
    grid = np.stack(np.meshgrid(X, Y, indexing="ij"), axis=-1)
    assert np.array_equal(H, grid[seen])
    assert_allclose(w, np.where(seen, np.exp(-phi) * area, 0.0), rtol=1e-14)
    c = PROCESS.coefficients(grid.reshape(-1, 2))
    s, divergence = c.drift.reshape(7, 5, 2), c.divergence.reshape(7, 5, 2)
    b = c.diffusion.reshape(7, 5, 2, 2)
    slopes = np.stack([first, second], axis=-1)
    alpha = s - 0.5 * divergence + 0.5 * np.einsum("xyij,xyj->xyi", b, slopes)
    found = weighted_on_grid(w, seen, first, second, *evaluated(PROCESS, H))
    assert_allclose(found[:2], w * np.moveaxis(alpha, -1, 0), rtol=1e-12, atol=1e-14)
    expected = -0.5 * w * np.stack([b[..., 0, 0], b[..., 0, 1], b[..., 1, 1]])
    assert_allclose(found[2:], expected, rtol=1e-12)


def test_slopes_without_flux_are_those_of_a_linear_system() -> None:
    H, scales = np.random.default_rng(7).uniform(0.1, 3.0, (40, 2)), np.array([2.0, 0.5])
    s, divergence, b = evaluated(PROCESS, H)
    slopes, regular = flux_free_slopes(s, divergence, b, scales)
    expected = np.linalg.solve(b, (2.0 * s - divergence)[..., None])[..., 0]
    assert regular
    assert_allclose(slopes, (expected * scales).T, rtol=1e-12, atol=1e-14)


def test_noise_that_leaves_a_combination_alone_is_refused() -> None:
    def diffusion(H: np.ndarray) -> np.ndarray:
        return np.asarray(2.0 * H[:, :, None] * H[:, None])

    process = Process.of_functions(lambda H: 1.0 - H, diffusion, lambda H: 6.0 * H, (1.0, 1.0))
    with pytest.raises(NotCertified, match="gets no noise"):
        probed(process)


def test_fits_of_rising_degree_are_least_squares_fits() -> None:
    target = -LOG_P(X[:, None], Y).ravel() + np.sin(3.0 * np.add.outer(X, Y)).ravel()
    grid = grid_of(X, Y, 4)
    powers = [of_total_degree(k) for k in range(5)]
    columns = [(grid.x[:, None, p[:, 0]] * grid.y[:, p[:, 1]]).reshape(-1, len(p)) for p in powers]
    found = list(fits(zip(powers, columns, strict=True), target))
    assert len(found) == 5
    for degree, (c, misfit) in enumerate(found):
        matrix = np.concatenate(columns[: degree + 1], axis=1)
        best = matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0]
        assert_allclose(grid_of(X, Y, degree).values(c).ravel(), best, rtol=0.0, atol=1e-9)
        expected = np.linalg.norm(best - target) / np.linalg.norm(target)
        assert_allclose(misfit, expected, rtol=1e-9)


def test_fits_end_where_the_places_do_not_tell_columns_apart() -> None:
    ones, x = np.ones((6, 1)), np.linspace(0.0, 1.0, 6)[:, None]
    blocks = [(of_total_degree(0), ones), (of_total_degree(1), np.hstack([x, x]))]
    assert len(list(fits(iter(blocks), x[:, 0]))) == 1


def test_values_and_slopes_on_a_grid_are_those_at_its_points() -> None:
    c = np.random.default_rng(3).normal(size=(4, 4))
    grid, step = grid_of(X, Y, 3), 1e-5
    at = np.broadcast_arrays(X[:, None], Y)
    assert_allclose(grid.values(c), values_at(c, *at), rtol=1e-13)
    for axis, slope in enumerate(grid.slopes(c)):
        near = [
            values_at(c, at[0] + k * (axis == 0), at[1] + k * (axis == 1)) for k in (-step, step)
        ]
        assert_allclose(slope, (near[1] - near[0]) / (2.0 * step), rtol=1e-6, atol=1e-6)
