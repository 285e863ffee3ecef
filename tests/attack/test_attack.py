"""No certified answer outside its stated error: random chains, every deterministic route."""

import ast
from pathlib import Path

import numpy as np
import pytest
import references
from attack_run import OF_METHOD, Attack
from references import Chain, Term

from averaging.phase_space.method import PhaseSpace
from fpk.answer.method import ROUTES

FAST = (0, 16, 22, 24, 44)
"""Seeds of the default tier."""
LEAST_CERTIFIED = 0.6


def assert_honest(seeds):
    answers = [answer for seed in seeds for answer in Attack(seed).answers()]
    lies = [f"{a.name}: {a.lie}" for a in answers if a.lie]
    assert not lies, "\n".join(lies)
    certified = sum(a.certified for a in answers)
    assert certified >= LEAST_CERTIFIED * len(answers)
    assert any(a.referenced for a in answers)


@pytest.mark.parametrize("seed", FAST)
def test_no_certified_answer_outside_its_stated_error(seed):
    assert_honest([seed])


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 200, 5))
def test_two_hundred_chains(first):
    assert_honest(range(first, first + 5))


@pytest.mark.parametrize("term", [Term(0, -0.01, "q"), Term(0, -0.03, "q"), Term(0, -0.02, "v")])
def test_densities_that_do_not_exist_are_not_certified(term):
    """The drift of an energy grows like +H²: no density is stationary, however far the tail."""
    chain = Chain(np.ones(2), np.ones(2), np.diag([0.1, 0.1]), np.diag([0.05, 0.05]), terms=(term,))
    for answer in Attack(0, chain).answers(referenced=False):
        assert not answer.certified, answer.name


def test_every_deterministic_route_has_a_reference():
    kinds = [type(route.make()) for route in ROUTES.values() if not route.sampled]
    own = [kind for kind in kinds if kind.__module__.partition(".")[0] in ("averaging", "cases")]
    # Judged by tests of its own, on systems whose full equation has a known solution.
    own.remove(PhaseSpace)
    assert own and set(own) <= OF_METHOD.keys()


def test_references_import_nothing_of_the_product():
    tree = ast.parse(Path(references.__file__).read_text(encoding="utf-8"))
    imports = [ast.unparse(x) for x in ast.walk(tree) if isinstance(x, ast.Import | ast.ImportFrom)]
    rooms = {line.split()[1].partition(".")[0] for line in imports}
    assert "numpy" in rooms and not rooms & {"fpk", "averaging", "sim", "cases"}
