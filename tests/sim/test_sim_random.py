"""The stream of normals: exact numbers, moments, correlations."""

import platform

import numpy as np
from numba import njit

from sim import random

SEED = 8131


def word(seed: int, trajectory: int, counter: int) -> int:
    mask = (1 << 64) - 1
    z = (((trajectory << 40) + counter) * int(random.GOLDEN) + int(random.mixed_seed(seed))) & mask
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
    return z ^ (z >> 31)


def test_normals_are_box_muller_of_the_stated_words() -> None:
    paths, counter, seed = 3000, 12345, 2**64 - 1
    z = random.normals(seed, paths, counter, 2)
    words = [word(seed, t, counter) for t in range(paths)]
    r = np.array([np.sqrt(-2.0 * np.log(((w >> 24) + 0.5) / 2**40)) for w in words])
    angle = np.array([((w & 0x3FFFFF) + 0.5) / 2**22 - 0.5 for w in words]) * np.pi / 2
    swap = np.array([bool(w >> 22 & 1) for w in words])
    sign = np.array([-1.0 if w >> 23 & 1 else 1.0 for w in words])
    first = sign * r * np.where(swap, np.sin(angle), np.cos(angle))
    second = sign * r * np.where(swap, np.cos(angle), np.sin(angle))
    np.testing.assert_allclose(z, [first, second], rtol=0, atol=4e-8)


def test_a_number_does_not_depend_on_how_many_are_drawn() -> None:
    z = random.normals(SEED, 500, 6, 4)
    np.testing.assert_array_equal(z[:, :70], random.normals(SEED, 70, 6, 4))
    np.testing.assert_array_equal(z[2:], random.normals(SEED, 500, 7, 2))
    assert not np.array_equal(z, random.normals(SEED + 1, 500, 6, 4))


def test_moments_and_correlations() -> None:
    """z-scores of 24 independent figures below 4.5: false alarm 2e-4."""
    steps, paths = 64, 1 << 14
    z = random.normals(SEED, paths, 0, steps)
    N = z.size
    scores = [
        z.mean() * np.sqrt(N),
        (z**2).mean() * np.sqrt(N / 2) - np.sqrt(N / 2),
        (z**3).mean() * np.sqrt(N / 15),
        ((z**4).mean() - 3) * np.sqrt(N / 96),
        ((z**6).mean() - 15) * np.sqrt(N / (10395 - 225)),
    ]
    for lag in (1, 2, 3, 4, 8):
        for a, b in ((z[lag:], z[:-lag]), (z[:, lag:], z[:, :-lag])):
            scores.append((a * b).sum() / np.sqrt(a.size))
            if lag <= 4:
                scores.append(((a**2 - 1) * (b**2 - 1)).sum() / np.sqrt(4 * a.size))
    assert len(scores) >= 20
    assert np.max(np.abs(scores)) < 4.5


def test_the_loop_is_compiled_to_vector_instructions() -> None:
    fresh = njit(fastmath=random.FLAGS, error_model="numpy")(random._fill_blocks.py_func)
    fresh(np.empty((1, 2 * random.LANES)), np.uint64(0), np.uint64(0))
    assembly = "".join(fresh.inspect_asm().values())
    if platform.machine() in ("x86_64", "AMD64"):
        assert "sqrtpd" in assembly
