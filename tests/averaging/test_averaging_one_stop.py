"""p(H) of one mass between stops against quadrature over the displacement, and its certificate."""

import numpy as np
import pytest
from asked import solved

from averaging.theory import Exact
from fpk import Contact, System

EXPONENTS = {"hertz": 1.5, "bilinear": 1.0}
X, W = np.polynomial.legendre.leggauss(80)
SHARE, REST = np.sin(0.25 * np.pi * (1.0 + X)) ** 2, np.cos(0.25 * np.pi * (1.0 + X)) ** 2
SLOPE = 0.5 * np.pi * np.sqrt(SHARE * REST) * W
ROUND_OFF = 4e-15
"""Relative round-off of the reference."""


def system_of(stiffness, damping, noise, stops, mass=1.0):
    """One mass with ``stops``: side, stiffness, clearance and law of each."""
    contacts = tuple(Contact(1, *stop) for stop in stops)
    return System([mass], [stiffness], [[damping]], [[noise]], contacts=contacts)


def beyond(k, stop, energy):
    """∫dx/√(E − kδx − kx²/2 − B x^(e+1)/(e+1)) from the stop to the turning point, E > 0."""
    e, B, gap = EXPONENTS[stop.law], stop.stiffness, stop.clearance
    low, high = np.zeros_like(energy), np.sqrt(2.0 * energy / k)
    for _ in range(200):
        x = 0.5 * (low + high)
        above = k * gap * x + 0.5 * k * x * x + B * x ** (e + 1.0) / (e + 1.0) > energy
        low, high = np.where(above, low, x), np.where(above, x, high)
    parts = np.array([k * gap * x, 0.5 * k * x * x, B * x ** (e + 1.0) / (e + 1.0)])
    a, b, c = (parts / parts.sum(axis=0))[:, :, None]
    # What is left of E at x sin²φ, not as a difference.
    left = a * REST + b * REST * (1.0 + SHARE) - c * np.expm1((e + 1.0) * np.log(SHARE))
    return x / np.sqrt(energy) * np.sum(SLOPE / np.sqrt(left), axis=1)


def by_quadrature(system, kT, energy):
    """p(H) = ∫(H − V)^(−½) dq e^(−H/kT)/√(π kT)/∫e^(−V/kT) dq."""
    k, states, whole = float(system.stiffness[0]), np.zeros_like(energy), 0.0
    reach = np.sqrt(90.0 * kT / k)
    for side in ("left", "right"):
        stop = next((s for s in system.stops if s.side == side), None)
        gap = reach if stop is None else min(stop.clearance, reach)
        inside = np.minimum(np.sqrt(0.5 * k / energy) * gap, 1.0) if stop else 1.0
        states += np.sqrt(2.0 / k) * np.arcsin(inside)
        lengths = [(0.0, gap)]
        if stop is not None:
            above = energy > 0.5 * k * gap * gap
            states[above] += beyond(k, stop, energy[above] - 0.5 * k * gap * gap)
            lengths.append((gap, min(reach, float(stop.overlap_at(45.0 * kT)))))
        for start, length in lengths:
            nodes = start + length * np.linspace(0.0, 1.0, 41) ** 3
            half = 0.5 * np.diff(nodes)[:, None]
            q = nodes[:-1, None] + half * (1.0 + X)
            V = 0.5 * k * q * q
            if stop is not None:
                e, over = EXPONENTS[stop.law] + 1.0, np.maximum(q - gap, 0.0)
                V = V + stop.stiffness * over**e / e
            whole += float(np.sum(half * W * np.exp(-V / kT)))
    return states * np.exp(-energy / kT) / (np.sqrt(np.pi * kT) * whole)


def assert_certified_and_right(system):
    """Every check of p(H) holds, and next to each energy of a stop p is right to its error."""
    (p,) = solved(Exact(), system, "H")
    assert p.certificate.certified, p.certificate.failures
    assert p.l1_error < 1e-11
    kT = float(system.noise_matrix[0, 0] / system.damping[0, 0])
    touched = [0.5 * system.stiffness[0] * s.clearance**2 for s in system.stops]
    shares = np.array([0.5, 1.0 - 1e-6, 1.0 + 1e-12, 1.0 + 1e-8, 1.0 + 1e-5, 1.001, 1.1, 3.0])
    H = np.append(
        kT * np.array([1e-12, 1e-6, 0.01, 0.3, 1.0, 3.0, 10.0]), np.outer(touched, shares)
    )
    H = H[H > 0.0]
    value, error = p.at(H)
    expected = by_quadrature(system, kT, H)
    assert np.all(np.abs(value - expected) <= error + ROUND_OFF * expected)


STOPS = {
    "far and none": (
        [("left", 22636.573, 2.10133450600572, "bilinear"), ("right", 184.84, 0.0, "hertz")],
        (0.13803692208250382, 0.053247678927404375, 6.890192884958267),
    ),
    "Hertz, both": ([("both", 118.9207115, 0.014142135623730949, "hertz")], (1.0, 0.1, 0.05)),
    "near and far, stiff": (
        [("left", 2e6, 0.085, "bilinear"), ("right", 433.0, 0.562, "bilinear")],
        (5.9, 0.1, 0.027),
    ),
    "very stiff": ([("right", 1e8, 0.4, "bilinear")], (1.0, 0.1, 0.1)),
}


@pytest.mark.parametrize("name", STOPS)
def test_the_mass_of_the_energy_is_one_to_its_error(name):
    stops, numbers = STOPS[name]
    assert_certified_and_right(system_of(*numbers, stops))


@pytest.mark.parametrize("share", [-4e-16, 0.0, 4e-16])
def test_the_energy_of_a_stop_itself_is_known_to_its_rounding(share):
    # p rises from there like √(H − H_c), so that one rounding of H_c is 1e-8 of p.
    system = system_of(1.0, 0.1, 0.1, (("both", 1e6, 0.7, "bilinear"),))
    (p,) = solved(Exact(), system, "H")
    (contact,) = {0.5 * s.clearance**2 for s in system.stops}
    H = np.array([contact * (1.0 + share)])
    value, error = p.at(H)
    assert 1e-9 < error[0] / value[0] < 3e-8
    assert abs(value - by_quadrature(system, 1.0, H)) <= error
