"""The references of the attack share nothing with the product and agree among themselves."""

import ast
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from attack_energy import Chain, EnergyReference, Stop, Term
from attack_linear import LinearReference, ModalReference
from scipy.integrate import quad

HERE = Path(__file__).parent
ALONE = ("attack_quadrature", "attack_energy", "attack_linear")
ROOMS = {"fpk", "averaging", "sim", "cases"}


@pytest.mark.parametrize("module", ALONE)
def test_references_import_nothing_of_the_product(module):
    tree = ast.parse((HERE / f"{module}.py").read_text(encoding="utf-8"))
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add((node.module or "").partition(".")[0])
    assert names
    assert not names & ROOMS


def one(stops=(), terms=()):
    return Chain(
        np.array([1.3]), np.array([2.0]), np.array([[0.1]]), np.array([[0.05]]), stops, terms
    )


def two(stops=(), terms=(), *, ratio=1.0):
    return Chain(
        np.array([1.0, 2.0]), np.array([1.0, ratio]), np.diag([0.1, 0.3]), np.diag([0.05, 0.15]),
        stops, terms,
    )  # fmt: skip


RIGHT = (Stop(0, 1.0, 30.0, 0.3, 1.5),)
BOTH = (Stop(1, 1.0, 10.0, 0.5, 1.5), Stop(1, -1.0, 10.0, 0.5, 1.5))
TWO = (Stop(0, 1.0, 30.0, 0.3, 1.5), Stop(1, -1.0, 5.0, 0.0, 2.2))


@pytest.mark.parametrize(
    "chain",
    [
        one(RIGHT),
        one(RIGHT, (Term(0, 0.3, "q", 0),)),
        two(BOTH),
        two(BOTH, (Term(0, 0.3, "v", 1),)),
        two(TWO),
    ],
    ids=["one", "one-q", "two", "two-v", "both"],
)
def test_reference_of_the_energy_has_mass_one(chain):
    """The normalisation comes from configuration space, the density from the shells."""
    reference = EnergyReference(chain)
    cuts = sorted(
        {0.0, *(reference.contact_energy_of(s) for s in chain.stops), 0.5, 2.0, 5.0, 20.0}
    )
    x, w = np.polynomial.legendre.leggauss(24)
    t = 0.5 * (x + 1.0)
    total = 0.0
    for a, b in pairwise(cuts):
        # Both ends are approached by the fourth power: shells begin with powers of the distance.
        inner = t**4 * (35 - 84 * t + 70 * t**2 - 20 * t**3)
        slope = 140 * t**3 * (1 - t) ** 3
        total += (b - a) * np.sum(reference.of_energy(a + (b - a) * inner)[0] * slope * 0.5 * w)
    assert total == pytest.approx(1.0, abs=2e-7)


def test_reference_of_a_displacement_is_the_configuration_integral():
    chain = two(BOTH, ratio=1e4)
    alpha = (0.1 + 0.15) / (0.05 + 0.075)

    def boltzmann(q1, q2):
        overlap = max(abs(q2) - 0.5, 0.0)
        return np.exp(-alpha * (0.5 * q1**2 + 5e3 * (q2 - q1) ** 2 + 4.0 * overlap**2.5))

    def over_second(q1):
        return quad(lambda y: boltzmann(q1, y), q1 - 0.1, q1 + 0.1, epsabs=1e-14, epsrel=1e-12)[0]

    norm = 2.0 * quad(over_second, 0.0, 3.0, points=[0.5], epsrel=1e-10)[0]
    value, error = EnergyReference(chain).of_displacement(0, np.array([0.05]))
    assert value[0] == pytest.approx(over_second(0.05) / norm, rel=1e-9)
    assert error[0] < 1e-10


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
