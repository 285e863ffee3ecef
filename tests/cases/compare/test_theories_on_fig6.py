"""Averaging errors of both theories on Fig. 6, against a long independent calculation."""

import pytest

from averaging.integrable import Integrable
from averaging.nonintegrable import NonIntegrable
from cases.compare.compare import distance_between
from cases.scene.scene import load_scene
from fpk.answer.names import parse_observable
from sim.montecarlo import MonteCarlo


@pytest.mark.slow
@pytest.mark.parametrize(
    "method, independent, last_digit",
    [(NonIntegrable(), 0.01255, 5e-6), (Integrable(), 0.598, 5e-4)],
    ids=["nonintegrable", "integrable"],
)
def test_averaging_error_of_the_contact_displacement(method, independent, last_digit):
    """B = 10, δ = 0.5: 0.01255 and 0.598, known to their last digit."""
    system = load_scene("fig6a").system
    asked = [parse_observable("q2", 2)]
    (theory,) = method.solve(system, asked).densities
    (sampled,) = MonteCarlo(seed=20040806).solve(system, asked).densities
    distance, error, _ = distance_between(theory, sampled)
    assert distance == pytest.approx(independent, abs=error + last_digit)
