"""Upcrossings of a function: what quadrature and the end of the mesh cost is stated."""

import numpy as np
import pytest
from scipy.special import erfc

from fpk.answer.certificate import Measured
from fpk.answer.density import certify_density
from fpk.answer.dynamics import upcrossings
from fpk.answer.names import parse_observable

AT = np.array([-2.0, 0.0, 0.7, 5.0])


def joint_of(pdf, nodes, error=0.0, q=9.0):
    """The density ``pdf`` of q1 and p1 on panels to ±``q`` and between ``nodes``."""
    pair, measured = parse_observable("q1,p1", 1), Measured(1e-12, 0.0, 0.0, 0.0, 0.0)
    nodes = np.linspace(-q, q, 19), nodes
    return certify_density(
        pair, nodes, pdf, lambda q, p: error + 0.0 * (q + p), measured=measured, tol=1.0
    )


@pytest.mark.parametrize("panels", [1, 3, 40])
@pytest.mark.parametrize("reach", [1.5, 9.0, 50.0])
@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_the_error_holds_on_any_mesh(panels, reach, correlation):
    """Of a Gaussian known exactly: E max(p, 0) of a normal p | q, by its mean and deviation."""
    own = np.sqrt(1.0 - correlation**2)

    def pdf(q, p):
        square = (p - correlation * q) ** 2 / own**2 + q**2
        return np.exp(-0.5 * square) / (2.0 * np.pi * own)

    nodes = np.linspace(-reach, reach, 2 * panels + 1)
    joint = joint_of(pdf, nodes)
    values, errors = upcrossings(joint, 2.0, AT)
    z = correlation * AT / own
    flow = own * (np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi) + 0.5 * z * erfc(-z / np.sqrt(2.0)))
    exact = np.exp(-0.5 * AT**2) / np.sqrt(2.0 * np.pi) * flow / 2.0
    # 1e-14: the round-off of both formulas.
    assert np.all(np.abs(values - exact) <= errors + 1e-14 * exact)
    if reach == 9.0 and panels == 40:
        assert np.all(errors <= 1e-12 * np.max(exact))


@pytest.mark.parametrize("power", [1.5, 2.5])
def test_a_kink_within_a_panel_is_in_the_error(power):
    """f = (1 − H)^power, H = (q² + p²)/2 < 1: the rate is (1 − q²/2)^(power + 1)/(power + 1)."""

    def pdf(q, p):
        return np.maximum(1.0 - 0.5 * (q**2 + p**2), 0.0) ** power

    joint = joint_of(pdf, np.linspace(-2.0, 2.0, 9), q=2.0)
    at = np.linspace(0.0, 1.2, 2001)
    values, errors = upcrossings(joint, 1.0, at)
    exact = np.maximum(1.0 - 0.5 * at**2, 0.0) ** (power + 1.0) / (power + 1.0)
    missed = np.abs(values - exact) / (errors + 1e-14)
    # As ``DISTANCE_FACTOR`` says of kinks: with one coarser rule up to 15 % are outside, by factors
    # of 200.
    assert np.mean(missed > 1.0) < 0.03 and missed.max() < 3.0


@pytest.mark.parametrize("slope", [0.0, 1e-18, -1e-18])
def test_round_off_at_the_end_does_not_decide_the_error(slope):
    """There f is 0 within its error 1e-12: whether it falls by round-off says nothing."""

    def pdf(q, p):
        end = 1e-14 * (1.0 + slope * 1e14 * (8.0 - p))
        return np.where(np.abs(p) < 7.0, np.exp(-0.5 * (q * q + p * p)) / (2.0 * np.pi), end)

    joint = joint_of(pdf, np.linspace(-8.0, 8.0, 17), error=1e-12)
    _, errors = upcrossings(joint, 1.0, np.zeros(1))
    assert errors[0] < 2e-10  # 1e-12 (e + l) l, l = 8, and what the momenta below that add
