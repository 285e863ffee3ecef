"""Two energies in time: transients, rates and first passage of the plane's operator."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.stats import ncx2
from skfem import Basis, BilinearForm, ElementQuadP, LinearForm, MeshQuad
from skfem.helpers import dot, grad, mul
from test_fpk_plane import COUPLED, FIG8, manufactured, square_root_process

from fpk.numeric.errors import InvalidInput
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.plane.solution import root_spaced_nodes
from fpk.solvers.plane.stationary import solve_plane
from fpk.solvers.plane.time import transient
from fpk.solvers.plane.time.operator import PlaneOperator, PlaneStart
from fpk.solvers.plane.time.passage import PlaneLimit, plane_first_passage, relaxation_rates
from fpk.solvers.plane.time.transient import krylov_exponential, transient_densities


def density(process):
    return solve_plane(process, tol=1e-11)


@pytest.mark.parametrize("seeds", [range(3), pytest.param(range(3, 104), marks=pytest.mark.slow)])
def test_random_transients_are_within_their_stated_errors(seeds):
    """Pairs of square-root processes, of which each energy is noncentral χ² of two degrees."""
    certified = 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        c, d = 10.0 ** rng.uniform(-2, 0, 2), 10.0 ** rng.uniform(-2, 0, 2)
        c[1] = c[0] * 3.0 ** rng.uniform(-1, 1)
        start = d / c * rng.choice([0.0, 1.0], 2) * rng.exponential(1.5, 2)
        t = float(10.0 ** rng.uniform(-0.3, 1.0) / c.max())
        at = tuple(theta * rng.exponential(1.5, 40) for theta in d / c)
        of, tol = density(square_root_process(tuple(c), tuple(d))), 10.0 ** rng.uniform(-8, -3)
        times, begin = np.array([t]), PlaneStart(start)
        answer, _ = transient_densities(of, begin, (0, 1), times, at, tol=tol)
        half = -0.5 * d / c * np.expm1(-c * t)
        exact = ncx2(2.0, start * np.exp(-c * t) / half, scale=half).pdf(np.transpose(at))
        missed = np.abs(answer.values[0] - exact.prod(axis=1))
        assert np.all(missed <= answer.errors[0]), f"seed {seed}"
        certified += answer.certificate.certified
    assert certified >= 0.6 * len(seeds)


def test_reliability_is_the_mass_that_the_absorbing_forward_equation_keeps():
    # Another assembly, ∂p/∂t = −∇·J, J = (s − ½ ∇·b) p − ½ b ∇p, and another exponential.
    process, _ = manufactured(0.4, 0.2)
    mesh = MeshQuad.init_tensor(np.array([0.0, 0.1, 0.3, 0.6]), np.array([0.0, 0.1, 0.25, 0.5]))
    basis = Basis(mesh, ElementQuadP(8), intorder=22)
    x = np.asarray(basis.global_coordinates())
    at = process.coefficients(x.reshape(2, -1).T)
    fields = {
        "F": (at.drift - 0.5 * at.divergence).T.reshape(x.shape),
        "b": np.moveaxis(at.diffusion, 0, -1).reshape(2, *x.shape),
    }
    outwards = BilinearForm(lambda u, v, w: dot(w["F"] * u - 0.5 * mul(w["b"], grad(u)), grad(v)))
    held = basis.get_dofs(lambda x: np.isclose(x[0], 0.6) | np.isclose(x[1], 0.5)).all()
    free = np.setdiff1d(np.arange(basis.N), held)
    A, M = (
        form.assemble(basis, **fields).toarray()[np.ix_(free, free)]
        for form in (outwards, BilinearForm(lambda u, v, w: u * v))
    )
    begin = basis.probes(np.array([[0.2], [0.15]])).toarray()[0][free]
    p = expm(0.2 * np.linalg.solve(M, A)) @ np.linalg.solve(M, begin)
    kept = LinearForm(lambda v, w: 1.0 * v).assemble(basis)[free] @ p
    start, times = PlaneStart(np.array([0.2, 0.15])), np.array([0.2])
    answer = plane_first_passage(density(process), start, PlaneLimit(0.6, 0.5), times, tol=1e-8)
    assert answer.certificate.certified, answer.certificate.failures
    assert abs(answer.survival[0] - kept) <= 1e-9


def test_a_time_by_which_all_have_failed_spoils_no_other():
    process, _ = manufactured(0.4, 0.2)
    start, limit = PlaneStart(np.array([0.2, 0.15])), PlaneLimit(0.6, 0.5)
    alone, late = (
        plane_first_passage(density(process), start, limit, np.array(times), tol=1e-8)
        for times in ([0.2], [0.2, 1e6])
    )
    assert late.certificate.certified, late.certificate.failures
    assert abs(late.survival[0] - alone.survival[0]) <= late.survival_error[0]
    assert abs(late.survival[1]) <= late.survival_error[1] < 1e-8


def test_the_slowest_rate_is_that_of_a_finer_tolerance():
    process, _ = COUPLED["one of two modes"]
    coarse, fine = (relaxation_rates(density(process), 3, tol=tol) for tol in (1e-4, 1e-9))
    assert fine.certificate.certified, fine.certificate.failures
    assert np.all(np.abs(coarse.values - fine.values) <= coarse.errors + fine.errors)
    assert np.all(fine.values.real > 0.0)


def test_degenerate_rates_are_all_there():
    rates = relaxation_rates(density(square_root_process((0.1, 0.1), (0.02, 0.03))), 9, tol=1e-8)
    exact = 0.1 * np.array([1, 1, 2, 2, 2, 3, 3, 3, 3])
    assert np.all(np.abs(rates.values - exact) <= rates.errors)


@pytest.mark.parametrize(
    ("name", "seen"), [("ridge", (0, 1)), ("ridge", ()), ("Gibbs of H1 + H2", (0,))]
)
def test_coupled_transients_relax_to_the_exact_density(name, seen):
    process, log_p = COUPLED[name]
    of = density(process)
    x = np.linspace(0.05, 1.0, 5)
    at = (x, x) if seen == (0, 1) else (x,)
    start = PlaneStart(0.5 * np.array(process.energy_scales))
    answer, _ = transient_densities(of, start, seen, np.array([600.0]), at, tol=1e-8)
    assert answer.certificate.certified, answer.certificate.failures
    nodes = np.linspace(0.0, 1.0, 41)
    ends = (x[-1] for x in of.nodes)
    (a, v), (b, u) = ((z.ravel() for z in panel_rule(end * nodes, 12)) for end in ends)
    mass = v @ np.exp(log_p(a[:, None], b)) @ u
    if seen == (0, 1):
        exact = np.exp(log_p(x, x)) / mass
    elif seen == (0,):
        exact = np.exp(log_p(x[:, None], b)) @ u / mass
    else:
        s, r = (z.ravel() for z in panel_rule(nodes, 12))
        exact = x * (np.exp(log_p(x[:, None] * s, x[:, None] * (1.0 - s))) @ r) / mass
    assert np.all(np.abs(answer.values[0] - exact) <= answer.errors[0] + 1e-12)


def passage_from_rest(c, d, total, times=()):
    """First passage of H1 + H2 = ``total`` from rest, of two square-root processes."""
    of = density(square_root_process(c, d))
    limit, start = PlaneLimit(total=total), PlaneStart(np.zeros(2))
    return plane_first_passage(of, start, limit, np.array(times), tol=1e-8)


def test_a_failure_of_probability_1e_17_keeps_its_digits():
    c, d = 0.1, 0.05
    answer = passage_from_rest((c, c), (d, d), 40.0 * d / c, [1.0, 1e15, 1e17])
    assert answer.certificate.certified, answer.certificate.failures
    # E T of the gamma process of two: ∫_0^40 e^z (1 − (1 + z) e^−z)/z² dz/c (mpmath).
    exact = 155086592685738.702 / c
    assert abs(answer.mean.value - exact) <= answer.mean.error <= 1e-8 * exact
    # The reliability at such times is e^(−λt).
    expected = np.exp(-answer.rate.value * answer.times)
    assert_allclose(answer.survival, expected, rtol=0.0, atol=1e-8)
    # Long before, by a bound of P(T <= t).
    assert abs(answer.survival[0] - expected[0]) <= answer.survival_error[0] < 1e-9


def test_a_tiny_limit_is_passed_as_by_the_same_motion_without_damping():
    # Below it dH = 2 d dt + √(2 d H) dB: E T = H_f/(2 d), E T² − (E T)² = H_f²/(12 d²).
    c, d, small = 0.1, 0.05, 1e-100
    answer = passage_from_rest((c, c), (d, d), small)
    assert answer.certificate.certified, answer.certificate.failures
    # What damping does is of the relative size c H_f/d.
    assert abs(answer.mean.value - small / (2.0 * d)) <= answer.mean.error < 1e-8 * small / d
    variance = answer.variance
    assert abs(variance.value - small**2 / (12.0 * d**2)) <= variance.error
    assert variance.error <= 1e-8 * variance.value


@pytest.mark.parametrize(
    ("c", "d", "total", "words"),
    [
        (*FIG8, 1e4, "beyond the range"),
        ((0.1, 0.1), (0.05, 0.025), 140.0, "more equations than fit into memory"),
    ],
)
def test_a_limit_too_far_is_refused_before_any_work(c, d, total, words):
    with pytest.raises(InvalidInput, match=words):
        passage_from_rest(c, d, total)


@pytest.mark.parametrize("collapsed", [False, True])
def test_coordinates_and_energies_are_inverse(collapsed):
    process, _ = manufactured(0.4, 0.2)
    domain = PlaneOperator(process, root_spaced_nodes((0.6, 0.5), 4), 3, collapsed=collapsed)
    H = np.array([[0.2, 0.7], [0.0, 0.4], [0.3, 0.0]]).T
    back = domain.energies(*domain.coordinates(*H))
    assert_allclose(back, H, atol=1e-15)
    # G is the inverse of ∂H/∂y.
    y, h = (np.array([0.5]), np.array([0.3])), 1e-6
    columns = [
        (np.array(domain.energies(y[0] + h * a, y[1] + h * b)) - domain.energies(*y)) / h
        for a, b in ((1.0, 0.0), (0.0, 1.0))
    ]
    jacobian = np.stack([z[:, 0] for z in columns], axis=1)
    b = np.array([[0.7, 0.2], [0.2, 0.4]])
    parts = np.array([1.0, 1.0, 2.0, b[0, 0], b[0, 1], b[1, 1]])[:, None]
    w, *F, b11, b12, b22 = domain.pulled_back(*y, parts)[:, 0]
    assert_allclose([w, abs(np.linalg.det(jacobian))], 0.5 if collapsed else 1.0, rtol=1e-5)
    assert_allclose(jacobian @ F, w * np.array([1.0, 2.0]), rtol=1e-5)
    of_y = np.array([[b11, b12], [b12, b22]])
    assert_allclose(jacobian @ of_y @ jacobian.T, w * b, rtol=1e-5)


@pytest.mark.parametrize("k", [0, 2, 4])
def test_nan_is_not_lost_where_the_largest_residual_of_krylov_spaces_is_taken(monkeypatch, k):
    nodes = root_spaced_nodes((5.0, 5.0), 3)
    op = PlaneOperator(square_root_process((0.1, 0.2), (0.1, 0.2)), nodes, 5)
    A, M, _ = op.matrices
    made = []

    def residual(*_):
        made.append(np.nan if len(made) == k else 0.0)
        return made[-1]

    monkeypatch.setattr(transient, "relative_residual", residual)
    # Times so far apart that no Krylov space serves both.
    dual, times = PlaneStart(np.zeros(2)).dual(op), np.array([1.0, 100.0])
    assert np.isnan(krylov_exponential(A, M, dual, times, tol=1e-6).residual) and len(made) > 4
