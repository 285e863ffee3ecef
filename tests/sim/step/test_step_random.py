"""The stream of normals: exact numbers, moments, correlations."""

import platform

import numpy as np
from numba import njit
from scipy.stats import chi2, norm

from fpk.numeric.compiling import FLAGS
from sim.step import random

SEED = 8131


def word(seed: int, trajectory: int, counter: int) -> int:
    mask, offset = (1 << 64) - 1, int(random.stream_offset(seed))
    z = (((trajectory << 40) + counter) * int(random.GOLDEN) + offset) & mask
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
    return z ^ (z >> 31)


def box_muller(radius: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Normals of the 32 bits of a radius and of an angle, in double precision."""
    r = np.sqrt(-2.0 * np.log((radius | 1) / 2.0**32)) * np.where(angle >> 31, -1.0, 1.0)
    theta = ((angle & 0x7FFFFF) / 2.0**22 - 1.0) * np.pi / 2
    return np.array([r * np.cos(theta), r * np.sin(theta)])


def test_normals_are_box_muller_of_the_stated_words() -> None:
    """To 2e-6 and 5e-7 of itself: polynomials to 1.2e-6 of one, and rounding of 24 bits."""
    paths, counter, seed = 3000, 12345, 2**64 - 1
    blocks = -(-paths // random.LANES)
    words = [word(seed, t, counter) for t in range(blocks * random.LANES)]
    halves = np.array([[w & 0xFFFFFFFF, w >> 32] for w in words]).reshape(blocks, 2, -1)
    expected = box_muller(*halves.transpose(1, 0, 2).reshape(2, -1)[:, :paths])
    z = random.normals(seed, paths, counter, 2)
    np.testing.assert_allclose(z, expected, rtol=5e-7, atol=2e-6)


def test_moments_and_correlations() -> None:
    """z-scores of 24 independent figures below 4.5: false alarm 2e-4."""
    z = random.normals(SEED, 1 << 14, 0, 64)
    N = z.size
    known = ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96), (6, 15, 10395 - 225))
    scores = [((z**k).mean() - mean) * np.sqrt(N / variance) for k, mean, variance in known]
    for lag in (1, 2, 3, 4, 8):
        for a, b in ((z[lag:], z[:-lag]), (z[:, lag:], z[:, :-lag])):
            scores.append((a * b).sum() / np.sqrt(a.size))
            if lag <= 4:
                scores.append(((a**2 - 1) * (b**2 - 1)).sum() / np.sqrt(4 * a.size))
    assert len(scores) >= 20 and np.max(np.abs(scores)) < 4.5


def test_adjacent_seeds_are_independent() -> None:
    """Sums of z and z² over a run of each seed, and correlations of neighbours, number by number.

    Σ of 64 squared z-scores is χ²_64 and 63 sums of products give as many z-scores, of z and of
    z² − 1, on the same and on the next trajectory: six figures, each end at 1e-5.
    """
    steps, paths = 32, 1 << 12
    z = np.array([random.normals(seed, paths, 0, steps) for seed in range(1, 65)])
    size, squares = steps * paths, (z**2 - 1.0) / np.sqrt(2.0)
    for x in (z, squares):
        assert abs(norm.ppf(chi2.cdf(np.sum(x.sum(axis=(1, 2)) ** 2) / size, 64))) < 4.3
        for shift in (0, 1):
            products = np.sum(x[1:] * np.roll(x[:-1], shift, axis=2), axis=(1, 2))
            assert abs(norm.ppf(chi2.cdf(np.sum(products**2) / size, 63))) < 4.3


def pairs_of(radius: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return (2, N) normals of given bits."""
    halves = np.concatenate([radius, angle]).astype(np.uint32)
    rows = np.empty(halves.size, np.float32)
    _fill(rows, halves)
    return rows.reshape(2, -1).astype(float)


@njit(fastmath=FLAGS, error_model="numpy")
def _fill(rows: np.ndarray, halves: np.ndarray) -> None:
    random.box_muller(rows, halves, halves.size // 2)


def test_radii_and_angles_of_all_bits() -> None:
    """At angle 0: cut at 6.66, no NaN, and no negative root where u rounds to 1.

    Then the radius by a midpoint rule on 2**21 of its cells, the angle on all 2**23. Midpoints of N
    cells of −2 log u miss E r² = 2 by (log 2)/N, added here. What is left is below the stated
    errors: 4e-7 and half a last place (6e-8 of 2) of r², 1.2e-6 of the sine.
    """
    bits = np.array([0, 1, 2, 3, 2**31, 2**32 - 200, 2**32 - 2, 2**32 - 1] * (random.LANES // 8))
    z = pairs_of(bits, np.full(bits.size, 1 << 22))[0][:8]
    expected = np.sqrt(-2.0 * np.log((bits[:8] | 1) / 2**32))
    np.testing.assert_allclose(z[:5], expected[:5], rtol=1e-6)
    np.testing.assert_allclose(z[5:], expected[5:], atol=2.0**-11.5)  # u is a number of 24 bits
    assert z[0] == z[1] > 6.65
    N = 1 << 21
    radius = ((2 * np.arange(N) + 1) << 10).astype(np.uint64)
    cosine = pairs_of(radius, np.full(N, 1 << 22))[0]
    assert abs(np.mean(cosine**2) + np.log(2.0) / N - 2.0) < 6e-7
    angle = np.arange(1 << 23)
    z = pairs_of(np.full(angle.size, 2**31), angle) / np.sqrt(2.0 * np.log(2.0))
    np.testing.assert_allclose(z @ z.T / angle.size, 0.5 * np.eye(2), atol=1.2e-6)


def test_the_loop_is_compiled_to_vector_instructions() -> None:
    fresh = njit(fastmath=FLAGS, error_model="numpy")(random._fill_blocks.py_func)
    rows, words = np.empty((2, random.LANES)), np.empty(random.LANES, np.uint64)
    fresh(rows, words, np.uint64(0), np.uint64(0))
    assembly = "".join(fresh.inspect_asm().values())
    if platform.machine() in ("x86_64", "AMD64"):
        assert "sqrtps" in assembly
