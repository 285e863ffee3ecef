"""Claims of a source: judged by numbers known beforehand, undecided within the noise."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from made_answers import Q1, gaussian, histogram, uniform
from scipy.special import ndtr

import fpk
from cases.compare.claims import findings, shape_of
from cases.compare.doubt import ACCEPTABLE_L1
from cases.compare.routes import all_routes
from cases.scene.expect import Expect
from cases.scene.scene import load_scene, shipped_scenes
from fpk.answer.contacts import StopClearance
from fpk.answer.method import ROUTES

ROUTE = {r.label: (r.method, r.solver) for r in all_routes()}


@dataclass(frozen=True)
class Found:
    """One curve whose answers are given."""

    answers: dict
    label: str = ""
    value: float | None = None
    ratio: float | None = 1.0

    @property
    def system(self):
        stops = (StopClearance(1, "right", 1.0, 1.0, self.ratio),)
        return SimpleNamespace(fact=lambda _: stops)

    def densities(self, observable):
        answers = {ROUTES[ROUTE[name]]: d for name, d in self.answers.items()}
        return answers if observable == Q1 else {}


def verdicts(expect, *curves):
    return [f.verdict for f in findings(expect, curves)]


def test_the_measures_of_densities_and_of_samples():
    """Uniform: kurtosis −6/5. A sample knows how well it knows its shape."""
    normal, flat = shape_of(gaussian(0.7)), shape_of(uniform())
    assert normal.l1 < 1e-12 and abs(normal.kurtosis) < 1e-8 and normal.almost_gaussian
    x = np.linspace(-6, 6, 400_001)
    g = np.exp(-1.5 * x**2) * np.sqrt(1.5 / np.pi)
    expected = np.sum(np.abs(g - 0.5 * (np.abs(x) < 1))) * (x[1] - x[0])
    assert flat.kurtosis == pytest.approx(-1.2, abs=1e-9)
    assert flat.l1 == pytest.approx(expected, abs=1e-4) and flat.almost_gaussian is False
    normal = shape_of(histogram())
    flat = shape_of(histogram(draw=lambda rng, n: rng.uniform(-2, 2, size=n)))
    assert abs(normal.kurtosis) < normal.kurtosis_error < 0.05 and normal.almost_gaussian
    assert abs(flat.kurtosis + 1.2) < flat.kurtosis_error + 0.01
    assert flat.almost_gaussian is False
    assert shape_of(histogram(size=30)).almost_gaussian is None


def test_gaussian_claims_are_about_the_curves_in_their_range():
    curves = [
        Found({"exact": gaussian()}, "B = 0.1", 0.1),
        Found({"exact": uniform()}, "B = 1", 1.0),
        Found({}, "B = 9", 9.0),
    ]
    above = Expect(Q1, non_gaussian=("above", 0.1))
    assert verdicts(above, *curves) == ["holds", "not checked"]
    least = Expect(Q1, almost_gaussian=("at_least", 0.1))
    assert verdicts(least, *curves) == ["holds", "does not hold", "not checked"]


def test_theories_are_ordered_beyond_the_noise_only():
    near, far = gaussian(1.01), gaussian(1.5)
    expect = Expect(Q1, better=("integrable", "nonintegrable"), acceptable=("nonintegrable",))
    for integrable, nonintegrable, expected in (
        (near, far, ["holds", "does not hold"]),
        (far, near, ["does not hold", "holds"]),
        (near, near, ["undecided", "holds"]),
    ):
        answers = {
            "exact": gaussian(),
            "integrable/closed-form": integrable,
            "nonintegrable/fem": nonintegrable,
        }
        assert verdicts(expect, Found(answers)) == expected
    noisy = {
        "montecarlo": histogram(size=200),
        "integrable/fem": gaussian(),
        "nonintegrable/fem": gaussian(1.001),
    }
    assert verdicts(expect, Found(noisy))[0] == "undecided"
    # The answer with the least error judges: a loose solution displaces no sharper simulation.
    for l1_error, expected in ((1e-6, "holds"), (0.5, "undecided")):
        both = {"phase-space": gaussian(l1_error=l1_error), **noisy}
        assert verdicts(expect, Found(both))[0] == expected
    assert verdicts(expect, Found({"exact": gaussian()})) == ["not checked", "not checked"]


@pytest.mark.parametrize("direction", ["larger", "smaller"])
def test_better_with_larger_is_asked_of_neighbours(direction):
    def curve(value, scale):
        answers = {"exact": gaussian(), "nonintegrable/closed-form": gaussian(scale)}
        return Found(answers, f"B = {value:g}", value)

    curves = [curve(10.0, 1.01), curve(0.1, 1.5), curve(1.0, 1.1)]
    found = verdicts(Expect(Q1, nonintegrable_better_with=direction), *curves)
    assert found == ["holds" if direction == "larger" else "does not hold"] * 2


@pytest.mark.parametrize(
    ("ratio", "scale", "expected"),
    [
        (2.5, 1.01, "holds"),
        (2.5, 1.5, "does not hold"),
        (1.5, 1.01, "does not hold"),
        (1.5, 1.5, "holds"),
        (None, 1.0, "not checked"),
    ],
)
def test_the_clearance_rule_speaks_of_both_its_sides(ratio, scale, expected):
    answers = {"exact": gaussian(), "integrable/closed-form": gaussian(scale)}
    assert verdicts(Expect(Q1, clearance_rule=2.0), Found(answers, ratio=ratio)) == [expected]
    assert 0 < ACCEPTABLE_L1 < 0.5


def test_every_figure_of_the_paper_states_what_it_claims():
    paper = [n for n, p in shipped_scenes().items() if p.parent.name == "paper"]
    assert len(paper) >= 12
    assert all(load_scene(name).expect is not None for name in paper)


def test_the_distance_to_the_gaussian_is_within_its_stated_error():
    """|p − Gaussian| has kinks, which no Gauss rule of the density's own panels integrates."""
    p = fpk.solve(fpk.load("fig6a").system, ["q2"], methods=["nonintegrable/fem"])["q2"]
    shape, scale = shape_of(p), p.moment(2).value ** 0.5
    x = np.linspace(p.panels[0][0], p.panels[0][-1], 400_001)
    gaussian = np.exp(-0.5 * (x / scale) ** 2) / (np.sqrt(2.0 * np.pi) * scale)
    expected = np.trapezoid(np.abs(p(x) - gaussian), x) + 2.0 * ndtr(x[0] / scale)
    assert abs(shape.l1 - expected) <= shape.l1_error + 1e-9
    assert shape.l1_error < 1e-5
