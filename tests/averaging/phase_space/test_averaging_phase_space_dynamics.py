"""Crossings, spectra, autocovariances and relaxation rates of the unreduced equation."""

import inspect

import numpy as np
import pytest
from asked import TURNED, ask

import fpk
from averaging.gaussian import Linear
from averaging.phase_space.dynamics import resolvent
from averaging.phase_space.dynamics.resolvent import displacement_vectors, generator, transforms
from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.elimination import expand
from averaging.phase_space.equation.frame import Reference, contact_frame, gibbs_reference
from averaging.phase_space.method import PhaseSpace
from averaging.phase_space.refinement import Options
from averaging.theory import Exact
from fpk.answer.method import silent
from fpk.answer.names import Coordinate, parse_observable
from fpk.numeric.errors import NotApplicable

ONE_SIDED = fpk.Contact(mass=1, side="right", stiffness=10.0, clearance=0.3)
GIBBS = fpk.System([2.0], [1.0], [0.4], [0.1], contacts=(ONE_SIDED,))
"""One mass, T = ¼; the mean of q is not 0."""


def wrong(system, factor):
    """The reference of a Gibbs state with a temperature that is off by ``factor``."""
    right = gibbs_reference(contact_frame(system))
    return Reference(right.slope, right.offset, factor * right.covariance, right.weight / factor)


@pytest.mark.parametrize("row", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_crossings_of_a_gibbs_state_are_exact_from_a_wrong_temperature(row):
    contact = fpk.Contact(mass=2, side="both", stiffness=10.0, clearance=0.5)
    system = fpk.System([1, 2], [1, 1], [0.08, 0.08], [0.02, 0.02], contacts=(contact,))
    a = np.linspace(-1.2, 1.2, 9)
    exact = ask(Exact(), "crossings", system, row, a)
    for tol in (1e-2, 1e-4):
        answer = ask(PhaseSpace(reference=wrong(system, 1.3)), "crossings", system, row, a, tol=tol)
        assert np.all(np.abs(answer.values - exact.values) <= answer.errors + exact.errors)
        assert np.all(answer.errors <= tol * 0.5 / np.pi)  # the scale is below 0.5/π


def test_crossings_of_a_linear_system_are_those_of_rice():
    a = np.linspace(-2.0, 2.0, 9)
    for row in (0, 1):
        exact = ask(Linear(), "crossings", TURNED, row, a)
        answer = ask(PhaseSpace(), "crossings", TURNED, row, a, tol=1e-8)
        assert np.all(np.abs(answer.values - exact.values) <= answer.errors + exact.errors)


@pytest.mark.parametrize("row", [0, 1])
def test_the_spectrum_of_a_linear_system_is_that_of_its_transfer_functions(row):
    w = np.array([0.0, -0.3, 0.3, 0.5, 0.55, 0.7, 1.0, 1.3, 2.0, 4.0])
    exact = ask(Linear(), "spectrum", TURNED, row, w)
    answer = ask(PhaseSpace(), "spectrum", TURNED, row, w, tol=1e-6)
    assert np.all(np.abs(answer.values - exact.values) <= answer.errors + exact.errors)
    assert answer.values == pytest.approx(exact.values, rel=1e-8)


def test_sums_over_the_spectrum_of_a_gibbs_state_with_contact_are_exact():
    # ω = tan θ; the rectangle rule of what is periodic and analytic in θ. ∫ S dω is the variance
    # of q, ∫ ω² S dω that of the velocity, T/m, and ω⁴ S goes to D/(π m²).
    count = 160
    w = np.tan((np.arange(count) + 0.5) * 0.5 * np.pi / count)
    answer = ask(PhaseSpace(), "spectrum", GIBBS, 0, w, tol=1e-5)
    weight = np.pi / count * (1.0 + w**2)
    settings = answer.settings
    (q,) = Exact().solve(GIBBS, [parse_observable("q1", 1)]).densities
    mean, square = (q.moment(k).value for k in (1, 2))
    assert settings["E q1²"] == pytest.approx(square, abs=1e-6)
    S, errors = answer.values, answer.errors
    assert weight @ S == pytest.approx(square - mean**2, abs=weight @ errors)
    assert (weight * w**2) @ S == pytest.approx(0.125, abs=(weight * w**2) @ errors)
    # The next term of the expansion in 1/ω is ω⁻² of the first times E[U''] and c², below 50.
    assert S[-1] * w[-1] ** 4 == pytest.approx(0.1 / (4.0 * np.pi), rel=50.0 / w[-1] ** 2)


@pytest.mark.parametrize("row", [0, 1])
def test_the_autocovariance_of_a_linear_system_is_that_of_its_exponential(row):
    lags = np.array([0.0, 0.1, 0.5, 1.0, 3.0, 7.3, 20.0, 100.0, 1000.0, 1e90])
    exact = ask(Linear(), "correlation", TURNED, row, lags)
    answer = ask(PhaseSpace(threads=1), "correlation", TURNED, row, lags)
    assert np.all(np.abs(answer.values - exact.values) <= answer.errors + exact.errors)
    assert np.all(answer.errors <= 1e-10 * exact.values[0])


def test_the_autocovariance_of_a_gibbs_state_with_contact_is_that_of_its_spectrum():
    # ω = tan θ; the rectangle rule of what is periodic in θ, of lags short beside the step in ω.
    count, lags = 240, np.array([0.0, 0.5, 1.0, 2.0])
    w = np.tan((np.arange(count) + 0.5) * 0.5 * np.pi / count)
    S = ask(PhaseSpace(threads=1), "spectrum", GIBBS, 0, w, tol=1e-4)
    weight = np.pi / count * (1.0 + w**2) * np.cos(np.outer(lags, w))
    answer = ask(PhaseSpace(threads=1), "correlation", GIBBS, 0, lags, tol=1e-4)
    (q,) = Exact().solve(GIBBS, [parse_observable("q1", 1)]).densities
    mean, square = (q.moment(k).value for k in (1, 2))
    assert abs(answer.values[0] - (square - mean**2)) <= answer.errors[0]
    assert np.all(np.abs(weight @ S.values - answer.values) <= np.abs(weight) @ S.errors)


def test_autocovariances_keep_to_their_error_against_a_finer_solution():
    lags = np.linspace(0.0, 20.0, 41)
    system = fpk.System([1.0], [1.0], [0.1], [0.05], contacts=(ONE_SIDED,))
    fine = ask(PhaseSpace(threads=1), "correlation", system, 0, lags, tol=1e-4)
    coarse = ask(PhaseSpace(threads=1), "correlation", system, 0, lags, tol=0.1)
    assert np.max(coarse.errors) > 5.0 * np.max(fine.errors)
    assert np.all(np.abs(coarse.values - fine.values) <= coarse.errors + fine.errors)


def test_what_the_space_leaves_of_a_correlation_is_in_its_error(monkeypatch):
    frame, lags = contact_frame(GIBBS), np.linspace(0.0, 20.0, 41)
    e = expand(frame, gibbs_reference(frame), Degrees(24, 0, 22))
    A = generator(e, odd=False)
    c, b = displacement_vectors(e, 0, A)

    def correlation(most):
        monkeypatch.setattr(resolvent, "VECTORS", most)
        values, error = resolvent.decays(A, c, b, lags, 1.0, lambda share: None, tol=1e-12)
        return values[0], error

    exact, left = correlation(300)
    assert exact[0] == pytest.approx(c @ b) and left <= 1e-12 * exact[0]
    for most in (20, 30, 40, 50, 60):
        values, error = correlation(most)
        assert 10.0 * left < np.max(np.abs(values - exact)) <= error + left


def test_one_elimination_serves_the_frequencies_about_its_shift(monkeypatch):
    frame = contact_frame(GIBBS)
    e = expand(frame, gibbs_reference(frame), Degrees(14, 0, 14))
    A, one = generator(e, odd=False), e.basis.of_one
    b = np.random.default_rng(20261123).normal(size=A.ends[-1])
    b[: one.size] -= one * (one @ b[: one.size])
    w = np.array([0.0, 0.2, 0.9, 1.0, 3.0])
    shifts = []
    solve = resolvent.solve_shifted
    monkeypatch.setattr(
        resolvent, "solve_shifted", lambda A, s, step: shifts.append(s) or solve(A, s, step)
    )
    values, residual = transforms(A, b, b, w, lambda share: None)
    assert residual <= resolvent.RESIDUAL and shifts[0] == 0.0 and len(shifts) <= 3
    for x, value in zip(w, values, strict=True):
        direct = b @ solve(A, 1j * x if x else 0.0, lambda share: None)(b)
        assert value == pytest.approx(direct, rel=1e-9)


def test_the_memory_that_a_spectrum_is_judged_by_holds_its_inverses(monkeypatch):
    judged, used = [], []
    refuse, eliminate = Options.refusal, resolvent.eliminate

    def factored(*chain, **options):
        solve, scale = eliminate(*chain, **options)
        inverses = inspect.getclosurevars(solve).nonlocals["inverses"]
        used.append(sum(inverse.nbytes for inverse in inverses))
        return solve, scale

    monkeypatch.setattr(resolvent, "eliminate", factored)
    monkeypatch.setattr(
        Options, "refusal", lambda b, size, work: judged.append(size) or refuse(b, size, work)
    )
    PhaseSpace().spectrum(
        GIBBS, (Coordinate("q", 0),), np.array([0.5, 3.0]), tol=1e-6, progress=silent
    )
    assert max(used) <= max(judged)


def test_what_the_expansion_does_not_hold_for_is_refused():
    contacts = tuple(
        fpk.Contact(mass=m, side="right", stiffness=1.0, clearance=0.1) for m in (1, 2)
    )
    system = fpk.System([1, 1], [1, 1], [0.1, 0.1], [0.1, 0.1], contacts=contacts)
    for question, arguments in (
        ("crossings", (0, np.zeros(1))),
        ("spectrum", (0, np.zeros(1))),
        ("correlation", (0, np.zeros(1))),
        ("relaxation", (3,)),
    ):
        with pytest.raises(NotApplicable, match="2 masses meet stops"):
            ask(PhaseSpace(), question, system, *arguments)
