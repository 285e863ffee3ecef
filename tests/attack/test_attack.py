"""No certified answer outside its stated error: random chains, every deterministic route."""

import pytest
from attack_run import OF_METHOD, Attack

from fpk.route import ROUTES

FAST = (3, 4, 11, 16, 22)
"""Seeds of the default tier; ``attack_run.py`` runs any."""
LEAST_CERTIFIED = 0.6


def assert_honest(seeds, **options):
    answers = [answer for seed in seeds for answer in Attack(seed).answers(**options)]
    lies = [f"{a.seed} {a.route} {a.observable}: {a.lie}" for a in answers if a.lie]
    assert not lies, "\n".join(lies)
    certified = sum(a.certified for a in answers)
    assert certified >= LEAST_CERTIFIED * len(answers)
    assert any(a.referenced for a in answers)


@pytest.mark.parametrize("seed", FAST)
def test_no_certified_answer_outside_its_stated_error(seed):
    assert_honest([seed])


def test_every_deterministic_route_has_a_reference():
    for route in ROUTES.values():
        if not route.sampled:
            assert type(route.make()) in OF_METHOD, f"{route.method}/{route.solver}"
