"""The averaged total energy in time, under constant and modulated noise: exact square-root
processes against elements."""

from dataclasses import replace

import numpy as np
import pytest
from asked import assert_agree, assert_near, assert_refused, modal_van_der_pol, passage, transient
from systems import both, chain

from averaging import Integrable, NonIntegrable
from fpk import Contact, DampingTerm, System
from fpk.answer.method import silent
from fpk.answer.names import parse_observable
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.numeric.quadrature import panel_rule
from fpk.system.modulation import Modulation

FREE = System([1.0, 2.0], [1.0, 3.0], [0.1, 0.3], [0.02, 0.05])
"""c = Σ(c_i/m_i)/2 = 0.125 and d = Σ(D_i/m_i)/2 = 0.0225, so that the temperature is 0.18."""
TOUCHING = replace(FREE, contacts=(Contact(2, "both", 10.0, 0.5),))
FADING = replace(FREE, modulation=Modulation([0.0, 4.0, 10.0], [0.2, 1.4, 0.0]))
FEM, CLOSED, QUADRATURE = (NonIntegrable(s) for s in ("fem", "closed-form", "quadrature"))
MODES, PLANE = Integrable("closed-form"), Integrable("fem")
THREE = chain(3)
STOPS = replace(THREE, contacts=(*both(10.0, mass=1), *both(10.0)))


def test_solvers_agree_on_first_passage_and_rates():
    a, b = (passage(m, FREE, "H=0.9", times=[0.0, 5.0, 50.0], tol=None) for m in (FEM, CLOSED))
    assert_agree(a, b)
    assert a.mean.error < 1e-10 * a.mean.value
    fem, closed = (m.relaxation(FREE, 4, tol=None, progress=silent) for m in (FEM, CLOSED))
    np.testing.assert_allclose(closed.values, 0.125 * np.arange(1, 5), rtol=1e-14)
    assert_near(fem, closed)


def spread_of(modulation, time, c=0.125, d=0.0225):
    """∫ d e² exp(−c (t − s)) ds by quadrature, which a gamma density from rest is scaled by."""
    nodes = np.unique(np.append(modulation.times[modulation.times < time], time))
    s, w = panel_rule(nodes, 30)
    return float((w * d * modulation(s) ** 2 * np.exp(-c * (time - s))).sum())


WITH_PAUSES = [0.0, 3.8, 8.3, 11.8, 17.5, 22.5, 23.0], [0.0, 0.0, 0.7, 0.3, 0.2, 1.7, 0.0]


@pytest.mark.parametrize(
    ("numbers", "start"),
    [(WITH_PAUSES, "rest"), (([0.0, 2.2, 5.0], [1.9, 0.5, 1.9]), "noise=0.3")],
)
def test_modulations_by_both_solvers(numbers, start):
    modulation = Modulation(*numbers)
    system, last = replace(FREE, modulation=modulation), float(modulation.times[-1])
    times, at = [0.4 * last, last, last + 3.0, last + 50.0], [0.0, 1e-3, 0.05, 0.3, 0.9]
    times = [t for t in times if start != "rest" or modulation.energy(t) > 0.0]
    exact, fem = (transient(m, system, "H", start, times, at, tol=1e-6) for m in (CLOSED, FEM))
    assert exact.certificate.certified
    assert_near(fem, exact)
    if start == "rest":
        theta = np.array([[spread_of(modulation, t)] for t in times])
        gamma = np.array(at) / theta**2 * np.exp(-np.array(at) / theta)
        # Tables of the reference: the exponent counts.
        np.testing.assert_allclose(exact.values, gamma, rtol=1e-10)


@pytest.mark.parametrize("factor", [1e-6, 3.0])
def test_modulated_noise_after_much_less_or_more_noise(factor):
    # From the stationary state it stays a gamma density; no element saw a narrow one.
    at = np.array([1e-8, 1e-3, 0.02, 0.1, 0.3])
    found = transient(FEM, FADING, "H", f"noise={factor}", [0.3], at, tol=1e-9)
    assert found.certificate.certified
    theta = spread_of(FADING.modulation, 0.3) + factor * 0.18 * np.exp(-0.125 * 0.3)
    exact = at / theta**2 * np.exp(-at / theta)
    assert np.all(np.abs(found.values[0] - exact) <= found.errors[0])
    assert found.errors.max() < 1e-8 * exact.max()
    if factor < 1.0:  # more than two halvings of the steps: Radau IIA of five stages
        assert found.settings["observed order"] == pytest.approx(9.0, abs=0.6)


def test_the_stationary_density_is_without_the_modulation():
    a, b = (FEM.solve(s, [parse_observable("H", 2)]).densities[0] for s in (FREE, FADING))
    assert a(0.3) == b(0.3)


def test_free_decay_shrinks_the_density():
    # Damping c of all energies: p(H, t) = e^(ct) p(e^(ct) H, 0).
    grown, at = np.exp(0.125 * 20.0), np.array([0.001, 0.01, 0.03])
    end = transient(FEM, FADING, "H", "rest", [10.0], at * grown, tol=1e-6)
    late = transient(FEM, FADING, "H", "rest", [30.0], at, tol=1e-6)
    bound = late.errors + grown * end.errors
    assert np.all(np.abs(late.values - grown * end.values) <= bound)
    assert late.certificate.certified and np.all(bound < 1e-4 * late.values)


@pytest.mark.parametrize(("name", "unit"), [("q1", FREE.compliance[0, 0]), ("p2", 2.0)])
def test_states_by_elements_are_the_exact_gaussian_from_rest(name, unit):
    # From rest each coordinate is Gaussian: θ(t) times its variance at temperature one.
    at, times = np.array([0.0, 0.3, 0.8]), [5.0, 10.0]
    variance = np.array([[spread_of(FADING.modulation, t)] for t in times]) * unit
    found = transient(FEM, FADING, name, "rest", times, at, tol=1e-6)
    exact = np.exp(-0.5 * at**2 / variance) / np.sqrt(2.0 * np.pi * variance)
    assert found.certificate.certified
    assert np.all(np.abs(found.values - exact) <= found.errors)
    assert np.max(found.errors) < 1e-3


@pytest.mark.parametrize("start", ["rest", "noise=0.5"])
def test_constant_modulation_is_constant_noise(start):
    times = [5.0, 20.0, 50.0]
    constant = replace(FREE, modulation=Modulation([0.0, 1.0], [1.0, 1.0]))
    steady, modulated = (passage(FEM, s, "H=0.9", start, times, 1e-5) for s in (FREE, constant))
    assert_agree(modulated, steady)
    assert modulated.survival_error.max() < 1e-5


def test_the_failed_part_of_the_start_has_an_error_of_its_own():
    # A gamma density of two masses beyond the limit: e^(−x)(1 + x), x = H/θ, θ = 0.3 d/c.
    x = 0.9 / (0.3 * 0.0225 / 0.125)
    answer = passage(FEM, FADING, "H=0.9", "noise=0.3", [0.0, 5.0], 1e-5)
    off = abs(answer.survival[0] - (1.0 - np.exp(-x) * (1.0 + x)))
    # The digits of d and c as they are written here are those of 1 of the survival.
    assert off <= answer.survival_error[0] + 1e-15
    assert answer.survival_error[0] < 1e-12


@pytest.mark.parametrize("name", ["H", "q1"])
def test_the_tolerance_that_is_asked_for_decides(name, monkeypatch):
    # Steps halved once: their error is above 1e-10, and nothing may loosen that.
    monkeypatch.setattr("fpk.solvers.line.time.modulated.STEP_HALVINGS", (0, 1))
    answer = transient(FEM, FADING, name, "rest", [5.0], [0.1], tol=1e-10)
    assert answer.settings["tol"] == 1e-10 and answer.certificate.missed > 1e-10


def test_after_the_noise_none_fails():
    answer = passage(FEM, FADING, "H=0.9", times=[0.0, 5.0, 10.0, 100.0], tol=1e-5)
    assert answer.certificate.certified
    assert answer.survival[0] == 1.0 and 0.0 < answer.survival[2] < answer.survival[1]
    assert answer.survival[2] == answer.survival[3]
    assert answer.mean.value == np.inf and answer.rate is None
    # The same and noise again: the reliability until then is the same.
    again = Modulation([0.0, 4.0, 10.0, 12.0, 14.0], [0.2, 1.4, 0.0, 0.0, 1.0])
    other = passage(FEM, replace(FREE, modulation=again), "H=0.9", times=[5.0, 10.0], tol=1e-5)
    bound = other.survival_error + answer.survival_error[1:3]
    assert np.all(np.abs(other.survival - answer.survival[1:3]) <= bound)
    assert np.isfinite(other.mean.value) and other.rate is not None


def test_a_pause_before_the_noise_only_shifts_a_motion_from_rest():
    at_once, later = (
        replace(FREE, modulation=Modulation(t, e))
        for t, e in (([0.0, 4.0], [0.0, 1.0]), ([0.0, 3.0, 7.0], [0.0, 0.0, 1.0]))
    )
    a = passage(FEM, at_once, "H=0.9", times=[5.0, 20.0], tol=1e-5)
    b = passage(FEM, later, "H=0.9", times=[2.0, 8.0, 23.0], tol=1e-5)
    assert b.survival[0] == 1.0
    np.testing.assert_allclose(b.survival[1:], a.survival, rtol=1e-14)
    assert b.mean.value - a.mean.value == pytest.approx(3.0, abs=2.0 * a.mean.error)
    assert b.variance.value == pytest.approx(a.variance.value, rel=1e-12)


QUIET = replace(FREE, modulation=Modulation([0.0, 3.0, 4.0], [0.0, 0.0, 1.0]))
SILENT = replace(FREE, modulation=Modulation([0.0], [0.0]))
ENDING = Modulation([0.0, 10.0], [1.0, 0.0])
DRIVEN = (DampingTerm(1, 1, 0.2, q=((1, 2),)),)
FED = System([1.0], [1.0], [-0.1], [0.02], damping_terms=DRIVEN, modulation=ENDING)
TRANSIENTS = [
    (FEM, FREE, "H1", "rest", [1.0], NotApplicable, "total energy"),
    (QUADRATURE, FREE, "H", "rest", [1.0], NotApplicable, "use fem"),
    (CLOSED, TOUCHING, "H", "rest", [1.0], NotApplicable, "contacts"),
    (FEM, FREE, "H", "H1=1,H2=1", [1.0], NotApplicable, "total energy"),
    (FEM, FREE, "H", "rest", [0.0, 1.0], InvalidInput, "no density"),
    (FEM, FREE, "H", "rest", [2.0, 1.0], InvalidInput, "ascend"),
    (FEM, FREE, "H", "rest", [np.nan], InvalidInput, "finite"),
    (FEM, QUIET, "H", "H=0.2", [5.0], InvalidInput, "decays without noise"),
    (FEM, QUIET, "H", "rest", [2.0], InvalidInput, "no noise has acted"),
    (CLOSED, QUIET, "H", "rest", [2.0], InvalidInput, "no noise has"),
    (FEM, FADING, "q1", "rest", [20.0], NotApplicable, "after the end of the noise"),
    (FEM, FED, "H", "rest", [12.0], NotApplicable, "feeds energy in"),
    # Displacements and momenta.
    (PLANE, THREE, "q1", "rest", [1.0], NotApplicable, "two modal energies, not for"),
    (QUADRATURE, FREE, "q1", "rest", [1.0], NotApplicable, "stationary densities"),
    (CLOSED, TOUCHING, "q1", "rest", [1.0], NotApplicable, "the system has contacts"),
    (FEM, STOPS, "p1", "rest", [1.0], NotApplicable, "one contact mass at the most"),
    (MODES, FREE, "q1,H1", "rest", [1.0], NotApplicable, "in time"),
    (MODES, FREE, "q1", "rest", [0.0], InvalidInput, "must be > 0"),
    (CLOSED, FREE, "q1,p1", "H=0.5", [1e-6], NotApplicable, "too narrow"),
    # Modal energies; where the noise is modulated, other reasons still come first.
    (PLANE, FREE, "H1", "H=0.3", [1.0], NotApplicable, "every modal"),
    (PLANE, FREE, "H1", "rest", [0.0, 1.0], InvalidInput, "> 0"),
    (PLANE, FREE, "H1", "rest", [2.0, 1.0], InvalidInput, "ascend"),
    (Integrable("quadrature"), FADING, "H1", "rest", [1.0], NotApplicable, "closed-form or fem"),
    (PLANE, FADING, "H1", "H=0.3", [1.0], NotApplicable, "every modal"),
    (PLANE, FADING, "H1", "rest", [1.0], NotApplicable, "modulated"),
]
PASSAGES = [
    (FEM, FREE, "H1=1", "rest", (), NotApplicable, "total energy"),
    (FEM, FREE, "q1<-1", "rest", (), NotApplicable, "^q1<-1: .* total energy"),
    (FEM, FREE, "H=1", "H=1", (), InvalidInput, "below the limit"),
    (FEM, FREE, "H=1000", "rest", (), InvalidInput, "beyond the range"),
    (FEM, FREE, "H=1", "rest", [-1.0], InvalidInput, "0 or later"),
    (CLOSED, FREE, "H=1", "noise=2", (), NotApplicable, "use fem"),
    (NonIntegrable("scikit-fem"), FREE, "H=1", "rest", (), NotApplicable, "^scikit-fem gives"),
    (FEM, replace(FREE, noise_intensity=[0, 0]), "H=1", "rest", (), NotApplicable, "no noise"),
    (CLOSED, FADING, "H=1", "rest", [1.0], NotApplicable, "modulated"),
    (MODES, FADING, "H1=1", "rest", [1.0], NotApplicable, "modulated"),
    (PLANE, FADING, "H1=1", "rest", [1.0], NotApplicable, "modulated"),
    (FEM, QUIET, "H=0.9", "H=0.2", [5.0], InvalidInput, "decays without noise"),
    (FEM, SILENT, "H=0.9", "rest", [5.0], NotApplicable, "no noise at any time"),
    (FEM, FED, "H=0.05", "rest", [12.0], NotApplicable, "feeds energy in"),
    (PLANE, FREE, "q2=1", "rest", (), NotApplicable, "no displacement"),
    (PLANE, FREE, "v2>1", "rest", (), NotApplicable, "^v2>1: .* velocity; use H"),
    (MODES, FREE, "H=1", "rest", (), NotApplicable, "use fem"),
    (PLANE, FREE, "H1=1", "H1=1,H2=0", (), InvalidInput, "below the limit"),
    (PLANE, FREE, "H=1", "H1=0.5,H2=0.6", (), InvalidInput, "below the limit"),
    (MODES, modal_van_der_pol(), "H1=1", "rest", (), NotApplicable, "use fem"),
    (Integrable("quadrature"), FREE, "H1=1", "rest", (), NotApplicable, "closed-form or fem"),
]


@pytest.mark.parametrize(
    ("ask", "method", "system", "name", "start", "times", "error", "words"),
    [*((transient, *row) for row in TRANSIENTS), *((passage, *row) for row in PASSAGES)],
)
def test_refusals_are_one_line(ask, method, system, name, start, times, error, words):
    points = [[0.1]] * (1 + name.count(",")) if ask is transient else []
    assert_refused(error, words, ask, method, system, name, start, times, *points)
