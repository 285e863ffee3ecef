"""Coefficients, probe and fits of two energies against plain NumPy."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from processes import process_of
from test_fpk_plane import manufactured

from fpk.numeric.errors import NotCertified
from fpk.solvers.plane.elements import by_element, flux_coefficients
from fpk.solvers.plane.weight import Weight, fits_by_degree, flux_free_weight, inverse_diffusion

PROCESS, LOG_P = manufactured(0.4, 0.2)
X, Y = np.linspace(0.1, 3.0, 7), np.linspace(0.2, 2.0, 5)
WEIGHT = Weight(np.array([[0.0, 1.2, 0.1], [0.8, 0.2, 0.0], [0.05, 0.0, 0.0]]), (1.0, 2.0))


@pytest.mark.parametrize("balanced", [False, True])
def test_coefficients_at_gauss_points_are_those_of_their_formulas(balanced: bool) -> None:
    H = np.stack(np.meshgrid(X, Y, indexing="ij"), axis=-1).reshape(-1, 2)
    at, weight = PROCESS.coefficients(H), replace(WEIGHT, floor=0.01)
    value, slope = weight(*H.T), np.stack(weight.slopes(*H.T), axis=-1)
    # A slope of −ln w, and but for the floor −b⁻¹ (2s − ∇·b) where no probability flows.
    share = 1.0 - 0.01 / value
    a = at.drift - 0.5 * at.divergence
    if balanced:
        a = -0.5 * np.einsum("nij,nj->ni", at.diffusion, slope)
    a = a + 0.5 * np.einsum("nij,nj->ni", at.diffusion, share[:, None] * slope)
    b = at.diffusion
    expected = (a[:, 0], a[:, 1], b[:, 0, 0], b[:, 0, 1], b[:, 1, 1])
    got, *parts = flux_coefficients(PROCESS, X[:, None], Y, weight, balanced=balanced)
    assert_allclose(got.ravel(), value, rtol=1e-13)
    for part, values in zip(parts, expected, strict=True):
        assert_allclose(part.ravel(), values * value, rtol=1e-12, atol=1e-15)


def test_elements_run_along_the_second_energy_fastest() -> None:
    grid = np.arange(2.0 * 3 * 3 * 4).reshape(6, 12)
    blocks = by_element(grid, (2, 3))
    assert blocks.shape == (6, 3, 4)
    assert np.array_equal(blocks[4], grid[3:6, 4:8])


def test_slopes_without_flux_are_those_of_a_linear_system() -> None:
    grid = np.stack(np.meshgrid(X, Y, indexing="ij"), axis=-1).reshape(-1, 2)
    c = manufactured(0.4, 0.0)[0].coefficients(grid)
    flow = 2.0 * c.drift - c.divergence
    expected = np.linalg.solve(c.diffusion, flow[..., None])[..., 0]
    assert_allclose(inverse_diffusion(flow, c.diffusion), expected, rtol=1e-9, atol=1e-12)


def test_noise_that_leaves_a_combination_alone_is_refused() -> None:
    def diffusion(H: np.ndarray) -> np.ndarray:
        return np.asarray(2.0 * H[:, :, None] * H[:, None])

    process = process_of(lambda H: 1.0 - H, diffusion, lambda H: 6.0 * H, (1.0, 1.0))
    with pytest.raises(NotCertified, match="gets no noise"):
        flux_free_weight(process)


def powers_to(degree: int) -> np.ndarray:
    return np.array([(i, k - i) for k in range(degree + 1) for i in range(k + 1)])


def test_fits_of_rising_degree_are_least_squares_fits() -> None:
    target = -LOG_P(X[:, None], Y).ravel() + np.sin(3.0 * np.add.outer(X, Y)).ravel()
    powers = powers_to(4)
    x, y = (a.ravel() for a in np.broadcast_arrays(X[:, None], Y))
    columns = x[:, None] ** powers[:, 0] * y[:, None] ** powers[:, 1]
    fitted = list(fits_by_degree(columns, target, powers))
    assert len(fitted) == 4
    for degree, (c, misfit) in enumerate(fitted, start=1):
        matrix = columns[:, powers.sum(axis=1) <= degree]
        best = matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0]
        values = np.polynomial.polynomial.polyval2d(x, y, c)
        assert_allclose(values, best, rtol=0.0, atol=1e-9)
        expected = np.linalg.norm(best - target) / np.linalg.norm(target)
        assert_allclose(misfit, expected, rtol=1e-9)


def test_fits_end_where_the_points_do_not_tell_columns_apart() -> None:
    x = np.linspace(0.0, 1.0, 8)
    columns = np.column_stack([np.ones(8), x, x, x**2, x**2, x**2])
    assert not list(fits_by_degree(columns, x, powers_to(2)))


def test_a_weight_on_a_grid_is_that_at_its_points_and_its_slopes() -> None:
    on_grid, slopes = WEIGHT(X[:, None], Y), WEIGHT.slopes(X[:, None], Y)
    at, step = np.broadcast_arrays(X[:, None], Y), 1e-5
    assert_allclose(on_grid, WEIGHT(*at), rtol=1e-13)
    for axis, slope in enumerate(slopes):
        near = [
            -np.log(WEIGHT(at[0] + k * (axis == 0), at[1] + k * (axis == 1))) for k in (-step, step)
        ]
        assert_allclose(slope, (near[1] - near[0]) / (2.0 * step), rtol=1e-6, atol=1e-6)
