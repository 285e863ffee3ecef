"""No certified answer outside its stated error: random chains, every deterministic route."""

import ast
from itertools import pairwise
from pathlib import Path

import attack_references
import numpy as np
import pytest
from attack_references import Chain, EnergyReference, LinearReference, ModalReference, Stop, Term
from attack_run import OF_METHOD, Attack

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
    tree = ast.parse(Path(attack_references.__file__).read_text(encoding="utf-8"))
    imports = [ast.unparse(x) for x in ast.walk(tree) if isinstance(x, ast.Import | ast.ImportFrom)]
    rooms = {line.split()[1].partition(".")[0] for line in imports}
    assert "numpy" in rooms and not rooms & {"fpk", "averaging", "sim", "cases"}


def one(*stops):
    numbers = ([1.3], [2.0], [[0.1]], [[0.05]])
    return Chain(*map(np.array, numbers), stops)


def two(*stops, terms=()):
    numbers = ([1.0, 2.0], [1.0, 1.0], np.diag([0.1, 0.3]), np.diag([0.05, 0.15]))
    return Chain(*map(np.array, numbers), stops, terms)


BOTH = (Stop(1, 1.0, 10.0, 0.5, 1.5), Stop(1, -1.0, 10.0, 0.5, 1.5))


@pytest.mark.parametrize(
    "chain",
    [
        one(Stop(0, 1.0, 30.0, 0.3, 1.5)),
        two(*BOTH),
        two(*BOTH, terms=(Term(0, 0.3, "H"), Term(1, 0.9, "H"))),
    ],
    ids=["one", "two", "two-H"],
)
def test_reference_of_the_energy_has_mass_one(chain):
    """The normalisation comes from configuration space, the density from the shells."""
    reference, total = EnergyReference(chain), 0.0
    touched = (chain.contact_energy_of(s) for s in chain.stops)
    x, w = np.polynomial.legendre.leggauss(24)
    t = 0.5 * (x + 1.0)
    for a, b in pairwise(sorted({0.0, *touched, 0.5, 2.0, 5.0, 20.0})):
        # Both ends are approached by the fourth power: shells begin with powers of the distance.
        inner = t**4 * (35 - 84 * t + 70 * t**2 - 20 * t**3)
        slope = 140 * t**3 * (1 - t) ** 3
        total += (b - a) * np.sum(reference.of_energy(a + (b - a) * inner)[0] * slope * 0.5 * w)
    assert total == pytest.approx(1.0, abs=2e-7)


@pytest.mark.parametrize("n", [1, 2])
def test_references_agree_where_damping_and_noise_are_in_proportion(n):
    """Without contact, with c = h D, full system, modes and energy give one density."""
    chain = one() if n == 1 else two()
    references = [kind(chain) for kind in (EnergyReference, LinearReference, ModalReference)]
    x = np.array([0.01, 0.3, 1.7])
    for name, i in (("of_energy", None), ("of_displacement", n - 1), ("of_momentum", 0)):
        values = [getattr(r, name)(*([] if i is None else [i]), x)[0] for r in references]
        np.testing.assert_allclose(values[1], values[0], rtol=1e-11)
        np.testing.assert_allclose(values[2], values[0], rtol=1e-11)


@pytest.mark.parametrize("i", [0, 1])
def test_reference_of_a_displacement_is_the_configuration_integral(i):
    """Of two masses of which one has stops, by the trapezoidal rule on a grid."""
    axis = np.linspace(-6.0, 6.0, 2401)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    over = np.maximum(np.abs((x, y)[i]) - 0.5, 0.0)
    weight = np.exp(-2.0 * (0.5 * x**2 + 0.5 * (y - x) ** 2 + 4.0 * over**2.5)).sum(axis=1)
    stops = [s._replace(index=i) for s in BOTH]
    value, _ = EnergyReference(two(*stops)).of_displacement(0, axis[1200:1500:100])
    right = weight[1200:1500:100] / weight.sum() / 0.005
    np.testing.assert_allclose(value, right, rtol=1e-6)
