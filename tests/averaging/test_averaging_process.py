"""The averaged process and its density: Eqs. (25), (28), (29) with their corrections, (11)."""

import numpy as np
import pytest
from asked import assert_known, refusal, solved
from systems import both, chain

from averaging import NonIntegrable
from averaging.energy_process import energy_process
from averaging.zero_flux import solve_by_quadrature
from fpk import Contact, DampingTerm, System
from fpk.answer.density import l1_distance
from fpk.answer.names import parse_observable
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.stationary import solve_stationary


def cycle(n, noise, contacts=()):
    """Van der Pol's damping −0.05 + 0.1 q₁² of the first mass."""
    return System(
        np.ones(n),
        np.ones(n),
        [-0.05, *[0.02] * (n - 1)],
        np.full(n, noise),
        contacts=contacts,
        damping_terms=(DampingTerm(1, 1, 0.1, q=((1, 2),)),),
    )


@pytest.mark.parametrize(
    "n, stiff, noise",
    [
        (1, True, 0.1),
        (2, False, 0.001),
        (2, True, 0.01),
        pytest.param(1, True, 0.001, marks=pytest.mark.slow),
    ],
)
def test_limit_cycles_are_found_wherever_they_are(n, stiff, noise):
    system = cycle(n, noise, (Contact(n, "both", 10.0, 0.5),) if stiff else ())
    process = energy_process(system)
    # What the quadratures of one mass with contact leave open adds up over 100 nats and more.
    tol = 1e-8 if n == 1 and stiff else 1e-9
    fem = solve_stationary(process, tol=tol)
    direct = solve_by_quadrature(process, tol=tol)
    nodes = np.unique([*fem.nodes, *direct.nodes[direct.nodes < fem.nodes[-1]]])
    x, w = panel_rule(nodes, 16)
    p, s = fem.density(x), np.exp(direct.log_density(x))
    assert fem.certificate.certified and direct.l1_error < tol
    assert np.sum(w * np.abs(p - s)) <= fem.l1_error + direct.l1_error


def test_the_limit_cycle_of_one_mass_is_a_gaussian_of_the_energy():
    # ⟨q² v²⟩ = H²/2 for k = m = 1: u = exp(−(H − 1)²/(2 s²)), s² = D/0.05, cut at H = 0.
    noise = 1e-4
    system = cycle(1, noise)
    width = np.sqrt(noise / 0.05)
    x = np.array([0.8, 0.95, 1.0, 1.1])
    expected = np.exp(-(((x - 1.0) / width) ** 2) / 2.0) / np.sqrt(2.0 * np.pi) / width
    for solver in ("fem", "quadrature"):
        H = solved(NonIntegrable(solver), system, "H")[0]
        # e^−250 of the mass of the Gaussian lies below 0.
        np.testing.assert_allclose(H.at(x)[0], expected, rtol=1e-9)
        assert H.at(np.array([1e-3]))[0] < 1e-100


def test_energies_of_two_levels_are_weighed_against_each_other():
    # α(H) = (H − ½)(H − 2)(H − 4)/D, fed twice: p = exp(−∫α)/Z, with hundreds of nats between.
    D, c = 0.01, np.poly([0.5, 2.0, 4.0])[::-1]
    terms = tuple(DampingTerm(1, 1, c[e], energy=e) for e in range(1, 4))
    system = System([1.0], [1.0], [c[0]], [D], damping_terms=terms)
    levels = np.polynomial.polynomial.polyint(c / D)

    def exponent(H):
        return -np.polynomial.polynomial.polyval(H, levels)

    top = max(exponent(0.5), exponent(4.0))
    assert exponent(0.5) - exponent(2.0) > 50.0

    def weight(H):
        return np.exp(exponent(H) - top)

    x, w = panel_rule(np.linspace(0.0, 7.0, 281), 20)
    norm = np.sum(w * weight(x))
    H = np.array([0.3, 0.5, 0.7, 2.0, 3.9, 4.1])
    # A tolerance that the round-off of α, a sum of powers up to H³, does not reach over 300 nats.
    for solver in ("closed-form", "fem", "quadrature"):
        method = NonIntegrable(solver, tol=1e-9)
        density = solved(method, system, "H")[0]
        exact = weight(H) / norm
        assert_known(density, [H], exact, rounding=1e-11 * exact)


def test_what_has_no_stationary_density_is_refused_with_the_reason():
    def one(damping, noise, *terms, contacts=()):
        return System([1], [1], [damping], [noise], contacts=contacts, damping_terms=terms)

    driving, odd = DampingTerm(1, 1, -0.1, q=((1, 2),)), DampingTerm(1, 1, 0.1, q=((1, 1),))
    stopped = one(0.1, 0.1, driving, contacts=both(10.0, mass=1))
    for solver, system, name, reason in (
        ("fem", one(0.1, 0.1, driving), "H", "grows for ever"),
        ("quadrature", stopped, "H", "grows for ever"),
        ("fem", one(0.0, 0.1, odd), "q1", ""),  # without contact it does nothing
        ("fem", one(0.1, 0.0, DampingTerm(1, 1, 0.1, energy=1)), "q1", "no noise"),
        ("closed-form", cycle(1, 0.1), "H", "fem and quadrature"),
    ):
        given = refusal(NonIntegrable(solver), system, name)
        assert given and reason in given
    assert NonIntegrable("fem").refusal(cycle(1, 0.1), parse_observable("H", 1)) is None


@pytest.mark.parametrize("contacts", [(), (Contact(1, "both", 10.0, 0.3),)], ids=["free", "stop"])
def test_terms_that_cancel_to_round_off_leave_it_in_the_stated_error(contacts):
    """c11 gains a (1 + 5e-15) q1² and −a q1²: what is left is 5e-15 a q1², known to no digit."""

    def density(solver, *coefficients):
        terms = tuple(DampingTerm(1, 1, c, q=((1, 2),)) for c in coefficients)
        return solved(NonIntegrable(solver), chain(2, contacts, damping_terms=terms), "H")[0]

    large = 1e6 * (1.0 + 5e-15)
    for solver in ("fem", "quadrature"):
        both, one = density(solver, large, -1e6), density(solver, large - 1e6)
        assert both.l1_error >= l1_distance(both, one) - one.l1_error
