"""The factor of modulated noise: its energy, the part that damping leaves, and refusals."""

import numpy as np
import pytest

from fpk.numeric.errors import InvalidInput
from fpk.numeric.quadrature import panel_rule
from fpk.system.modulation import Modulation


@pytest.mark.parametrize("rate", [-2.0, -1e-3, 0.0, 1e-6, 1e-3, 1.0, 100.0])
@pytest.mark.parametrize("seed", range(4))
def test_the_part_of_the_noise_that_damping_leaves(rate, seed):
    """∫ e² exp(−rate (end − s)) ds by quadrature; negative damping feeds energy in."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 6))
    times = np.append(0.0, np.cumsum(rng.uniform(0.5, 6.0, count - 1)))
    modulation = Modulation(times, rng.uniform(0.2, 2.0, count) * (rng.random(count) < 0.8))
    begin = rng.uniform(0.0, 3.0)
    end = begin + rng.uniform(0.1, 20.0)
    layers = end - (end - begin) * 0.5 ** np.arange(40.0)
    inner = times[(begin < times) & (times < end)]
    s, w = panel_rule(np.unique([begin, *inner, *layers, end]), 20)
    expected = float((w * modulation(s) ** 2 * np.exp(-rate * (end - s))).sum())
    # A thousand roundings of the sum by quadrature, and those of e(t) in double.
    found = float(modulation.faded(begin, end, np.array(rate)))
    assert found == pytest.approx(expected, rel=2e-12, abs=1e-300)
    if rate == 0.0:
        s, w = panel_rule(np.unique([0.0, *times[times < end], end]), 4)
        assert modulation.energy(end) == pytest.approx(float((w * modulation(s) ** 2).sum()))


@pytest.mark.parametrize(
    ("times", "factor", "word"),
    [
        ([0, 1], [1.0], "one per time"),
        ([1, 2], [0.5, 1.0], "begin with 0"),
        ([0, 2, 2], [0.5, 0.6, 1.0], "ascend"),
        ([0, 1], [-0.5, 1.0], "negative"),
        ([], [], "list"),
        ([0, np.inf], [1.0, 1.0], "finite"),
        ("x", [1.0], "finite"),
        ([0, 1], [1.0, 1e160], "must be 0 or from"),
        ([0, 1], [1.0, 1e-170], "must be 0 or from"),
    ],
)
def test_modulations_that_make_no_sense_are_refused(times, factor, word):
    with pytest.raises(InvalidInput, match=word):
        Modulation(times, factor)


@pytest.mark.parametrize("step", [1e-3, 2.0])
def test_the_mean_square_of_a_step_keeps_its_digits_after_loud_noise(step):
    """24 decades below what came before, and with kinks inside; by two points a segment, exact."""
    modulation = Modulation([0.0, 10.0, 10.5, 11.0, 20.0], [1e6, 1e6, 1e-6, 3e-6, 2e-6])
    begins = np.linspace(10.6, 21.0, 27)
    exact = []
    for begin in begins.tolist():
        inner = [t for t in modulation.times.tolist() if begin < t < begin + step]
        s, w = panel_rule(np.array([begin, *inner, begin + step]), 2)
        exact.append(float(np.sum(w * modulation(s) ** 2)) / step)
    # A step of 1e-3 at the time 20 is known to 4e-12 of itself.
    got = modulation.mean_square(begins, step)
    np.testing.assert_allclose(got, exact, rtol=1e-11)
    np.testing.assert_allclose(modulation.mean_square(begins.reshape(9, 3), step).ravel(), got)
