"""Certificates of the Gaussian and of modal densities: measured, and judged by the tolerance."""

import mpmath
import numpy as np
import pytest
from averaging_systems import fig6
from modal_terms import modal_van_der_pol, solved

from averaging.gaussian import Linear
from averaging.integrable import Integrable
from averaging.modal.analysis import ModalAnalysis, modal_analysis
from averaging.zero_flux import flux_residual
from fpk.answer.names import parse_observable
from fpk.numeric.errors import InvalidInput
from fpk.system.linear import linear_covariance
from fpk.system.system import System

METHODS = [Linear(), *(Integrable(solver) for solver in ("closed-form", "quadrature", "fem"))]


def nearly_alike(split):
    """Two modes that a weak spring splits by little: what is computed of them loses digits."""
    D = np.array([0.01, 0.02])
    return System([1.0, 1.0], [1.0, split], 4.0 * D, D)


@pytest.mark.parametrize("name", ["H1", "H2,H1", "H", "q1", "p2", "q1,q2"])
def test_a_closed_form_is_judged_by_the_tolerance(name):
    # ω1 and ω2 differ by 1e-7 of their size: θ is known to 1e-9 or so.
    for tol, certified in ((1e-6, True), (1e-12, False)):
        (density,) = solved(Integrable(tol=tol), nearly_alike(1e-7), name)
        assert density.certificate.certified == certified, density.certificate
        assert sum("exceeds" in words for words in density.certificate.failures) == 1 - certified
        assert 1e-12 < density.l1_error < 1e-6


@pytest.mark.parametrize("name", ["H", "q1", "q1,p2"])
def test_the_gaussian_is_judged_by_the_tolerance(name):
    # Noise that all but misses one motion: its share is known to round-off of the other's.
    D = np.array([[1.0, 1.0 - 1e-9], [1.0 - 1e-9, 1.0]])
    system = System([1.0, 1.0], [1.0, 1e-6], [0.1, 0.1], D)
    for tol in (1e-3, 1e-12):
        (density,) = solved(Linear(tol=tol), system, name)
        assert density.certificate.certified == (density.l1_error <= tol)
    assert not density.certificate.certified


@pytest.mark.parametrize("method", METHODS, ids=lambda m: f"{m.method}/{m.solver}")
def test_what_is_certified_was_measured(method):
    name = "q1" if isinstance(method, Linear) else "H1"
    (density,) = solved(method, fig6(), name)
    c = density.certificate
    assert c.certified
    assert c.residual < 1e-12 and 0.0 < c.tail_mass < 1e-10
    assert c.mass_defect <= density.l1_error + 1e-14


@pytest.mark.parametrize("solver", ["closed-form", "quadrature", "fem"])
@pytest.mark.parametrize("tol", [1e-4, 1e-6, 1e-8, 1e-10])
def test_the_stated_error_holds_at_every_point(solver, tol):
    # The difference of two finite element solutions has zeros; the error has them elsewhere.
    (density,) = solved(Integrable(solver, tol), fig6(), "H1")
    theta = modal_analysis(fig6()).temperature[0]
    H = np.linspace(0.0, 0.999 * density.panels[0][-1], 2001)
    p, error = density.at(H)
    assert np.all(np.abs(p - np.exp(-H / theta) / theta) <= error)


def test_residual_of_a_wrong_density_is_not_round_off():
    modes = modal_analysis(fig6())
    process, theta = modes.process((0,)), modes.temperature[0]
    nodes = theta * np.linspace(0.0, 30.0, 11)
    assert flux_residual(process, nodes, lambda H: -H / theta) < 1e-15
    assert flux_residual(process, nodes, lambda H: -H / (1.001 * theta)) > 1e-4


@pytest.mark.parametrize("tol", [1e-13, 1.0])
def test_a_tolerance_out_of_range_is_refused(tol):
    with pytest.raises(InvalidInput, match="tol"):
        Linear(tol=tol)
    assert Linear(tol=1e-8).refined().tol == pytest.approx(1e-9)


def test_negative_values_of_waves_are_within_the_stated_error():
    system = modal_van_der_pol(others=0.0, mass=(0.5, 2.0))
    (density,) = solved(Integrable("quadrature", 1e-5), system, "q2,p2")
    x, y = (np.linspace(p[0], p[-1], 101) for p in density.panels)
    p, error = density.at(x[:, None], y)
    assert density.certificate.certified and density.certificate.minimum < 0.0
    assert np.all(p + error >= 0.0)


def linear_system(rng):
    """Chains of 1 to 4 masses: springs over six decades, damping over three, full noise."""
    n = int(rng.integers(1, 5))
    f = rng.normal(size=(n, n))
    D = 0.01 * f @ f.T
    return System(
        rng.uniform(0.5, 2.0, n),
        10.0 ** rng.uniform(-3.0, 3.0, n),
        10.0 ** rng.uniform(-3.0, 0.0, n),
        0.5 * (D + D.T),
    )


def exact_covariance(system):
    """Covariance of (q, p) in forty digits: every entry of A Σ + Σ Aᵀ + b = 0 as unknown."""
    n, mp = system.n, mpmath
    k = [mp.mpf(float(x)) for x in system.stiffness]
    A, b = mp.matrix(2 * n, 2 * n), mp.matrix(2 * n, 2 * n)
    for i in range(n):
        A[i, n + i] = 1 / mp.mpf(float(system.mass[i]))
        A[n + i, i] = -k[i] - (k[i + 1] if i + 1 < n else 0)
        if i:
            A[n + i, i - 1] = A[n + i - 1, i] = k[i]
        for j in range(n):
            A[n + i, n + j] = -mp.mpf(float(system.damping[i, j])) / mp.mpf(float(system.mass[j]))
            b[n + i, n + j] = 2 * mp.mpf(float(system.noise_matrix[i, j]))
    place = {}
    for i in range(2 * n):
        for j in range(i, 2 * n):
            place[i, j] = place[j, i] = len(set(place.values()))
    size = n * (2 * n + 1)
    M, right = mp.matrix(size, size), mp.matrix(size, 1)
    for i in range(2 * n):
        for j in range(i, 2 * n):
            row = place[i, j]
            for m in range(2 * n):
                M[row, place[m, j]] += A[i, m]
                M[row, place[i, m]] += A[j, m]
            right[row] = -b[i, j]
    x = mp.lu_solve(M, right)
    return mp.matrix([[x[place[i, j]] for j in range(2 * n)] for i in range(2 * n)])


@pytest.mark.parametrize("seed", [20261122, 1, 2, 3, 4, 5])
def test_random_linear_systems_keep_to_their_error(seed):
    rng = np.random.default_rng(seed)
    system = linear_system(rng)
    with mpmath.workdps(40):
        S = exact_covariance(system)
        modal = system.fact(linear_covariance)
        momenta = system.mass[:, None] * modal.shapes
        back = np.kron(np.diag([1.0, 0.0]), modal.shapes / modal.omega)
        back += np.kron(np.diag([0.0, 1.0]), momenta)
        factor = mpmath.matrix((back @ modal.axes * np.sqrt(modal.variance)).tolist())
        # Relative error as a quadratic form: the largest eigenvalue of L⁻¹ (F Fᵀ − Σ) L⁻ᵀ.
        inverse = mpmath.inverse(mpmath.cholesky(S))
        form = inverse * (factor * factor.T - S) * inverse.T
        error = max(abs(float(x)) for x in mpmath.eigsy(form, eigvals_only=True))
        assert error <= modal.relative_error < 1e-9, (error, modal.relative_error)
        for name in ("q1", f"p{system.n}", f"q{system.n},p1", f"q1,p{system.n}"):
            observable = parse_observable(name, system.n)
            (density,) = Linear().solve(system, [observable]).densities
            rows = [(c.index or 0) + (system.n if c.kind == "p" else 0) for c in observable]
            part = mpmath.matrix([[S[i, j] for j in rows] for i in rows])
            for y in rng.normal(size=(3, len(rows))):
                x = [float(mpmath.sqrt(part[i, i])) * float(v) for i, v in enumerate(y)]
                at = mpmath.matrix(x)
                exact = mpmath.exp(-(at.T * mpmath.inverse(part) * at)[0] / 2)
                exact /= mpmath.sqrt((2 * mpmath.pi) ** len(rows) * mpmath.det(part))
                p, stated = density.at(*(np.array([v]) for v in x))
                assert abs(p[0] - float(exact)) <= stated[0], name
            assert density.certificate.certified, density.certificate


def exact_modes(system):
    """ω², T with Tᵀ M T = 1 and the modal temperatures, in the working digits of mpmath."""
    n, mp = system.n, mpmath
    k = [mp.mpf(float(x)) for x in system.stiffness]
    root = [mp.sqrt(mp.mpf(float(x))) for x in system.mass]
    B = mp.matrix(n, n)
    for i in range(n):
        B[i, i] = (k[i] + (k[i + 1] if i + 1 < n else 0)) / root[i] ** 2
        if i:
            B[i, i - 1] = B[i - 1, i] = -k[i] / (root[i] * root[i - 1])
    squares, V = mp.eigsy(B)
    T = mp.matrix([[V[i, j] / root[i] for j in range(n)] for i in range(n)])
    c, d = (T.T * mp.matrix(x.tolist()) * T for x in (system.damping, system.noise_matrix))
    return squares, T, [d[i, i] / c[i, i] for i in range(n)]


@pytest.mark.parametrize("seed", [20261122, 1, 2, 3, 4, 5])
def test_random_modal_densities_keep_to_their_error(seed):
    rng = np.random.default_rng(seed)
    system = linear_system(rng)
    n, method = system.n, Integrable()
    if method.refusal(system, parse_observable("H1", n)):
        pytest.skip("in resonance")
    with mpmath.workdps(40):
        squares, T, theta = exact_modes(system)
        for name in ("H1", f"H{n}", "H", "q1", f"p{n}"):
            (density,) = solved(method, system, name)
            (coordinate,) = density.observable
            i = coordinate.index
            for share in rng.exponential(size=4):
                if coordinate.kind == "H" and i is not None:
                    x = share * float(theta[i])
                    exact = mpmath.exp(-mpmath.mpf(x) / theta[i]) / theta[i]
                elif coordinate.kind == "H":
                    x, exact = share * float(sum(theta)), mpmath.mpf(0)
                    for a in theta:
                        others = [a / (a - b) for b in theta if b is not a]
                        exact += mpmath.exp(-mpmath.mpf(x) / a) / a * mpmath.fprod(others)
                else:
                    factor = [1 / w for w in squares] if coordinate.kind == "q" else [1] * n
                    size = 1 if coordinate.kind == "q" else mpmath.mpf(float(system.mass[i]))
                    variance = sum((size * T[i, m]) ** 2 * theta[m] * factor[m] for m in range(n))
                    x = share * float(mpmath.sqrt(variance))
                    exact = mpmath.npdf(mpmath.mpf(x), 0, mpmath.sqrt(variance))
                p, stated = density.at(np.array([x]))
                assert abs(p[0] - float(exact)) <= stated[0] + 2.3e-16 * p[0], name
            assert density.certificate.certified == (density.l1_error <= method.tol_for(system))


@pytest.mark.parametrize("name", ["q1", "p2", "H"])
def test_the_residual_sees_wrong_modal_temperatures(name, monkeypatch):
    system = System([1.0, 2.0], [1.0, 3.0], [0.08, 0.04], [0.01, 0.02])
    observable = parse_observable(name, 2)
    (right,) = Integrable().solve(system, [observable]).densities
    assert right.certificate.certified
    temperature = ModalAnalysis.temperature
    wrong = property(lambda modes: temperature.__get__(modes) * (1.0 + 1e-9))
    monkeypatch.setattr(ModalAnalysis, "temperature", wrong)
    (density,) = Integrable().solve(system, [observable]).densities
    assert any("residual of the equation" in words for words in density.certificate.failures)
