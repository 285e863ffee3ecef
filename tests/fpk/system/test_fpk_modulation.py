"""The factor of modulated noise: its energy, the part that damping leaves, and refusals."""

import mpmath
import numpy as np
import pytest

from fpk.numeric.arrays import EPS, LARGEST_LOG
from fpk.numeric.errors import InvalidInput
from fpk.numeric.quadrature import panel_rule
from fpk.system.modulation import Modulation


def test_the_energy_of_the_modulation():
    modulation = Modulation([0.0, 4.0, 20.0], [0.2, 1.4, 1.0])
    s, w = panel_rule(np.array([0.0, 4.0, 20.0, 30.0]), 4)
    assert modulation.energy(30.0) == pytest.approx(float((w * modulation(s) ** 2).sum()))


@pytest.mark.parametrize("seed", range(8))
def test_the_part_of_the_noise_that_damping_leaves_against_mpmath(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 6))
    times = np.append(0.0, np.cumsum(rng.uniform(0.5, 6.0, count - 1)))
    modulation = Modulation(times, rng.uniform(0.2, 2.0, count) * (rng.random(count) < 0.8))
    begin, rate = rng.uniform(0.0, 3.0), 10.0 ** rng.uniform(-6.0, 2.0)
    end = begin + rng.uniform(0.1, 20.0)
    inner = [t for t in modulation.times.tolist() if begin < t < end]
    with mpmath.workdps(30):
        exact = mpmath.mpf(0)
        for a, b in zip([begin, *inner], [*inner, end], strict=True):
            # A square in s times an exponential, integrated by parts.
            k, h = mpmath.mpf(rate), mpmath.mpf(b) - a
            low, high = (mpmath.mpf(float(modulation(np.array(x)))) for x in (a, b))
            slope = (high - low) / h
            lower, upper = (
                e**2 / k - 2 * slope * e / k**2 + 2 * slope**2 / k**3 for e in (low, high)
            )
            exact += mpmath.exp(-k * (mpmath.mpf(end) - b)) * (upper - mpmath.exp(-k * h) * lower)
        got = mpmath.mpf(float(modulation.faded(begin, end, np.array(rate))))
        # 30 digits less those that 1/k³ cancels at the least rate, and those of e(t) in double.
        assert abs(got - exact) <= (LARGEST_LOG * EPS + 1e-12) * exact


@pytest.mark.parametrize("rate", [-2.0, -1e-3, 0.0])
def test_energy_fed_in_grows_where_damping_is_negative(rate):
    modulation = Modulation([0.0, 1.0, 3.0], [0.5, 2.0, 0.0])
    s, w = panel_rule(np.array([0.0, 1.0, 2.5]), 30)
    expected = float((w * modulation(s) ** 2 * np.exp(-rate * (2.5 - s))).sum())
    # 1200 roundings of the sum by quadrature, at the most.
    assert float(modulation.faded(0.0, 2.5, np.array(rate))) == pytest.approx(expected, rel=3e-13)


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
