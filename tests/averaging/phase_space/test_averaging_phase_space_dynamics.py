"""Crossings, spectra, autocovariances and relaxation rates of the unreduced equation."""

import numpy as np
import pytest
from asked import ask, assert_near, assert_refused
from scipy import sparse
from scipy.optimize import linear_sum_assignment
from scipy.sparse.linalg import eigs
from systems import TURNED, both, fig6
from test_averaging_phase_space import starting_from, wrong
from test_averaging_phase_space_plane import CUBIC, VAN_DER_POL

import fpk
from averaging.gaussian import Linear
from averaging.phase_space import resolvent
from averaging.phase_space.equation.degrees import Degrees, degrees_to
from averaging.phase_space.equation.elimination import expand
from averaging.phase_space.equation.frame import contact_frame, gibbs_reference
from averaging.phase_space.method import PhaseSpace
from averaging.phase_space.plane.mesh import energy_mesh
from averaging.phase_space.plane.oscillator import oscillator_of
from averaging.phase_space.plane.stationary import stationary_state
from averaging.phase_space.resolvent import generators
from averaging.theory import Exact
from fpk.answer.method import silent
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable

ONE_SIDED = fpk.Contact(mass=1, side="right", stiffness=10.0, clearance=0.3)
GIBBS = fpk.System([2.0], [1.0], [0.4], [0.1], contacts=(ONE_SIDED,))
"""One mass, T = ¼; the mean of q is not 0."""


def test_crossings_of_a_gibbs_state_are_exact_from_a_wrong_temperature():
    contact = fpk.Contact(mass=2, side="both", stiffness=10.0, clearance=0.5)
    system = fpk.System([1, 2], [1, 1], [0.08, 0.08], [0.02, 0.02], contacts=(contact,))
    a = np.linspace(-1.2, 1.2, 9)
    exact = ask(Exact(), "crossings", system, 1, a)
    for tol in (1e-2, 1e-4):
        with starting_from(wrong(system, 1.3)):
            answer = ask(PhaseSpace(), "crossings", system, 1, a, tol=tol)
        assert_near(answer, exact)
        assert np.all(answer.errors <= tol * 0.5 / np.pi)  # the scale is below 0.5/π


DISPLACEMENTS = np.linspace(-2.0, 2.0, 9)
W = np.array([0.0, -0.3, 0.3, 0.5, 0.55, 0.7, 1.0, 1.3, 2.0, 4.0])
LAGS = np.array([0.0, 0.1, 0.5, 1.0, 3.0, 7.3, 20.0, 100.0, 1000.0, 1e90])


@pytest.mark.parametrize("row", [0, 1])
@pytest.mark.parametrize(
    ("question", "at", "tol"),
    [("crossings", DISPLACEMENTS, 1e-6), ("spectrum", W, 1e-6), ("correlation", LAGS, None)],
)
def test_answers_of_a_linear_system_are_those_of_its_matrices(question, at, tol, row):
    exact = ask(Linear(), question, TURNED, row, at)
    answer = ask(PhaseSpace(threads=1), question, TURNED, row, at, tol=tol)
    assert_near(answer, exact)
    assert np.all(answer.errors <= 1e-6 * np.max(exact.values))


def summed(of, S):
    """∫ dω by the rule with the weights ``of``, and the larger error of a third of its points."""
    return of @ S, np.abs(of @ S - 3.0 * of[..., 1::3] @ S[1::3])


def assert_sums(system, tol, count=240):
    """Frequencies, answer and weights of ∫ dω: ∫ S dω and ∫ ω² S dω are variances of q and v.

    ω = tan θ; the rectangle rule of what is periodic and analytic in θ.
    """
    w = np.tan((np.arange(count) + 0.5) * 0.5 * np.pi / count)
    answer = ask(PhaseSpace(threads=1), "spectrum", system, 0, w, tol=tol)
    weight = np.pi / count * (1.0 + w**2)
    q, p = Exact().solve(system, [parse_observable(o, 1) for o in ("q1", "p1")]).densities
    velocity = p.moment(2).value / float(system.mass[0]) ** 2
    for power, variance in ((0, q.variance().value), (2, velocity)):
        of = weight * w**power
        value, quadrature = summed(of, answer.values)
        assert quadrature < 1e-3 * variance
        assert value == pytest.approx(variance, abs=of @ answer.errors + quadrature)
    return w, answer, weight


def test_sums_over_the_spectrum_of_a_gibbs_state_with_contact_are_exact():
    # ∫ S cos ωt dω is the autocovariance, and ω⁴ S goes to D/(π m²).
    w, answer, weight = assert_sums(GIBBS, 1e-4)
    lags, S = np.array([0.0, 0.5, 1.0, 2.0]), answer.values
    (q,) = Exact().solve(GIBBS, [parse_observable("q1", 1)]).densities
    assert answer.settings["E q1²"] == pytest.approx(q.moment(2).value, abs=1e-5)
    # The next term of the expansion in 1/ω is ω⁻² of the first times E[U''] and c², below 50.
    assert S[-1] * w[-1] ** 4 == pytest.approx(0.1 / (4.0 * np.pi), rel=50.0 / w[-1] ** 2)
    decay = ask(PhaseSpace(threads=1), "correlation", GIBBS, 0, lags, tol=1e-4)
    assert abs(decay.values[0] - q.variance().value) <= decay.errors[0]
    of = weight * np.cos(np.outer(lags, w))
    # cos ωt is not analytic at θ = π/2.
    values, quadrature = summed(of, S)
    assert quadrature.max() < 1e-4 * decay.values[0]
    stated = np.abs(of) @ answer.errors + decay.errors
    assert np.all(np.abs(values - decay.values) <= stated + quadrature)


def test_answers_keep_to_their_error_against_a_finer_solution():
    lags = np.linspace(0.0, 20.0, 41)
    system = fpk.System([1.0], [1.0], [0.1], [0.05], contacts=(ONE_SIDED,))
    coarse = ask(PhaseSpace(threads=1), "correlation", system, 0, lags, tol=0.1)
    fine = ask(PhaseSpace(threads=1), "correlation", system, 0, lags, tol=1e-4)
    assert np.max(coarse.errors) > 5.0 * np.max(fine.errors)
    assert_near(coarse, fine)
    assert_near(*(relaxation(GIBBS, 4, tol=tol) for tol in (3e-2, 1e-3)))


def plane():
    return stationary_state(energy_mesh(oscillator_of(GIBBS), 9.0, -1, 0.25))


def expansion():
    frame = contact_frame(TURNED)
    return expand(frame, gibbs_reference(frame), Degrees(24, 4, 22))


@pytest.mark.parametrize("solution", [plane, expansion])
def test_what_the_space_leaves_of_a_correlation_is_in_its_error(solution, monkeypatch):
    lags = np.linspace(0.0, 20.0, 41)
    A = next(generators(solution()))
    c, b = A.displacement(0)

    def correlation(most):
        monkeypatch.setattr(resolvent, "VECTORS", most)
        values, error = resolvent.decays(A, c, b, lags, 1.0, lambda share: None, tol=1e-12)
        return values[0], error

    exact, left = correlation(300)
    for most in (20, 40, 60):
        values, error = correlation(most)
        assert 10.0 * left < np.max(np.abs(values - exact)) <= error + left


def relaxation(system, count, tol):
    return ask(PhaseSpace(threads=1), "relaxation", system, count, tol=tol)


def distances(values, exact):
    """Distances of values to exact ones, each of which is taken once."""
    apart = np.abs(np.asarray(values)[:, None] - exact)
    rows, columns = linear_sum_assignment(apart)
    assert rows.size == len(values)
    return apart[rows, columns]


@pytest.mark.parametrize(
    ("system", "count"),
    [
        (fpk.System([1.0], [1.0], [0.02], [0.01]), 9),
        (fpk.System([1.0], [2.0], [4.0], [1.0]), 6),
        pytest.param(TURNED, 6, marks=pytest.mark.slow),
        # Both modes decay alike, and their energies, too: the rate 0.05 occurs twice.
        pytest.param(
            fpk.System([1, 1], [1, 1], [0.05, 0.05], [0.01, 0.02]), 8, marks=pytest.mark.slow
        ),
    ],
)
def test_rates_of_a_linear_system_are_the_slowest_sums_of_eigenvalues(system, count):
    exact = ask(Linear(), "relaxation", system, 60).values
    answer = relaxation(system, count, tol=1e-6)
    assert len(answer.values) == count
    assert np.all(distances(answer.values, exact) <= answer.errors)
    # No slower one is left out: sums of equal real parts may stand for each other.
    assert np.asarray(answer.values).real == pytest.approx(exact[:count].real, rel=1e-6)


def test_what_the_level_above_lacks_adds_no_slow_rates():
    """Without that part of ``Chain.matrix`` slower rates, 0.028 ± 1.41i, are found here."""
    frame = contact_frame(fig6(both(10.0)))
    e = expand(frame, gibbs_reference(frame), degrees_to(frame, 11, 11))
    parts = list(generators(e))
    rates, _ = resolvent.slowest_rates(parts, 2, 1.5, most=40, step=lambda share: None)
    # By degree 17 they are 0.0661 and 0.0950 + 1.6873i.
    assert rates[:2] == pytest.approx([0.0661, 0.0950 + 1.6873j], rel=0.03)


SOFT = fpk.Contact(mass=1, side="right", stiffness=0.1312, clearance=0.2304, law="bilinear")
LIGHT = fpk.System([20.9445], [0.309604], [0.47115], [0.00865627], contacts=(SOFT,))
"""Damping ratio 0.09: the fourth slowest rate turns three times as fast as the first."""


def by_differences(system, count, points=300, levels=24, reach=6.5):
    """Slowest eigenvalues of −L of one mass with c/D, by finite differences of second order.

    With p = φ Σ c_n(q) φ h_n(v), φ² the density of q and h_n Hermite functions,
    dc_n/dt = −n (c/m) c_n − √n a c_(n−1) + √(n+1) aᵀ c_(n+1), a f = √(T/m) φ ∂(f/φ)/∂q; c_n of
    even n stand on nodes, of odd n between them.
    """
    m, k, c, D = (
        float(np.ravel(x)[0])
        for x in (system.mass, system.stiffness_matrix, system.damping, system.noise_matrix)
    )
    T = D / c

    def potential(q):
        return 0.5 * k * q * q + system.contact_energy(0, q)

    far = reach * np.sqrt(T / k) * np.linspace(-1.0, 1.0, 4001)
    far = far[potential(far) < 0.5 * reach**2 * T]
    q = np.linspace(far[0], far[-1], 2 * points + 1)
    phi, rate = np.exp(-0.5 * potential(q) / T), np.sqrt(T / m) / (q[2] - q[0])
    nodes, middle, one = phi[::2], phi[1::2], np.ones(points)
    up = sparse.diags_array([-one, one], offsets=[0, 1], shape=(points, points + 1))
    slopes = [
        sparse.diags_array(rate * middle) @ up @ sparse.diags_array(1.0 / nodes),
        sparse.diags_array(rate * nodes) @ -up.T @ sparse.diags_array(1.0 / middle),
    ]
    blocks = [[None] * levels for _ in range(levels)]
    for n in range(levels):
        blocks[n][n] = n * c / m * sparse.eye_array(points + 1 - n % 2)
        if n:
            a = np.sqrt(n) * slopes[(n - 1) % 2]
            blocks[n][n - 1], blocks[n - 1][n] = a, -a.T
    A = sparse.block_array(blocks, format="csc").astype(complex)
    frequency, found = np.sqrt(k / m), np.zeros(0, dtype=complex)
    for at in range(0, 8, 2):
        # Off the axis, as A is singular at 0.
        sigma = (1j * at - 0.05) * frequency
        rates = eigs(A, k=40, sigma=sigma, return_eigenvectors=False)
        rates = rates[(np.abs(rates) > 1e-8) & (rates.imag > -1e-8)]
        apart = np.abs(rates[:, None] - found) < 1e-6 * np.abs(rates)[:, None]
        found = np.concatenate([found, rates[~apart.any(axis=1)]])
    return found[np.argsort(found.real)][:count]


@pytest.mark.parametrize(
    ("system", "count"),
    [
        (LIGHT, 4),
        pytest.param(LIGHT, 8, marks=pytest.mark.slow),
        pytest.param(GIBBS, 8, marks=pytest.mark.slow),
    ],
)
def test_rates_of_one_mass_are_those_of_finite_differences(system, count):
    other = by_differences(system, count)
    answer = relaxation(system, count, tol=5e-3)
    # The differences err by the square of a step of 0.04 standard deviations and less.
    allowed = answer.errors + 2e-3 * np.abs(answer.values)
    assert np.all(distances(answer.values, other) <= allowed)


@pytest.mark.parametrize(
    ("system", "question", "at", "known", "error"),
    [
        (VAN_DER_POL, "crossings", [-1.5, 0.0, 1.0, 2.0],
         [0.136114, 0.143034, 0.142776, 0.090459], [2.7e-4, 2.0e-4, 2.8e-4, 4.0e-4]),
        (VAN_DER_POL, "spectrum", [0.0, 0.5, 2.0, 3.0],
         [0.098651, 0.162939, 0.0228818, 0.0103801], [1.9e-3, 1.9e-2, 3.8e-4, 1.5e-4]),
        (VAN_DER_POL, "correlation", [0.0, 0.5, 1.5, 3.0, 6.0, 12.0],
         [2.19951, 1.94208, 0.45778, -1.60631, 0.98174, -0.13181],
         [2.8e-3, 2.6e-3, 2.3e-3, 3.4e-3, 5.1e-3, 8.2e-3]),
        (CUBIC, "crossings", [-1.2, -0.4, 0.0, 0.4],
         [0.052993, 0.188678, 0.212764, 0.123681], [2.9e-4, 2.9e-4, 3.0e-4, 3.9e-4]),
        (CUBIC, "spectrum", [0.5, 0.9, 1.0, 1.1, 2.0, 3.0],
         [0.037011, 0.069698, 0.092128, 0.129576, 0.0123953, 0.0014802],
         [5.6e-4, 1.3e-3, 1.8e-3, 1.9e-3, 1.7e-4, 2.2e-5]),
        (CUBIC, "correlation", [0.0, 0.5, 1.5, 3.0, 6.0, 12.0],
         [0.292854, 0.237079, -0.033072, -0.112937, 0.012273, -0.017295],
         [8.6e-4, 7.6e-4, 3.6e-4, 6.5e-4, 6.3e-4, 6.7e-4]),
    ],
)  # fmt: skip
def test_far_from_a_gaussian_answers_are_those_of_a_simulation(system, question, at, known, error):
    """Known ± a standard error by ``montecarlo`` as it is by default.

    Its spectrum has a bandwidth: no frequencies at the narrow peak of the limit cycle.
    """
    answer = ask(PhaseSpace(threads=1), question, system, 0, np.array(at), tol=1e-3)
    assert np.all(np.abs(answer.values - known) <= 4.0 * np.array(error) + answer.errors)
    assert answer.errors.max() <= np.max(error)


@pytest.mark.parametrize(
    ("limits", "count", "tol", "words"),
    [
        ({"DISCS": 1, "VECTORS": 50}, 12, 0.5, "of 12 rates are found: rates of angular freq"),
        ({"BLOCK": 1}, 1, 0.1, "occurs 1 times or more"),
    ],
)
def test_rates_that_may_be_missing_are_said_to(limits, count, tol, words, monkeypatch):
    for name, value in limits.items():
        monkeypatch.setattr(resolvent, name, value)
    answer = PhaseSpace().relaxation(LIGHT, count, tol=tol, progress=silent)
    assert any(words in failure for failure in answer.certificate.failures)


@pytest.mark.parametrize("question", ["crossings", "spectrum", "correlation", "relaxation"])
def test_what_the_expansion_does_not_hold_for_is_refused(question):
    contacts = tuple(fpk.Contact(m, "right", 1.0, 0.1) for m in (1, 2))
    system = fpk.System([1, 1], [1, 1], [0.1, 0.1], [0.1, 0.1], contacts=contacts)
    arguments = (3,) if question == "relaxation" else (0, np.zeros(1))
    words = "2 masses meet stops"
    assert_refused(NotApplicable, words, ask, PhaseSpace(), question, system, *arguments)
