"""Each integrator against a few lines of NumPy on the same stream; a new scheme; unstable steps."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm, solve_continuous_lyapunov
from sim_systems import fig6, linear, mixed, place, transient
from systems import in_units

from fpk.answer.names import REST, parse_limit, parse_observable
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.system.contact import Contact
from fpk.system.contact_law import LAWS, ContactLaw
from fpk.system.linear import diffusion_matrix, drift_matrix, flow_covariance
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.sample.ensemble import Ensemble
from sim.step.random import normals
from sim.step.schemes import (
    SCHEMES,
    LinearMap,
    Scheme,
    covariance_factor,
    exact_flow,
    lower_trapezoidal,
    register_scheme,
)
from sim.step.step_size import hottest, stability_limit

Array = NDArray[np.float64]
Step = Callable[[System, float, Array, Array, Callable[[int], Array]], tuple[Array, Array]]


def contact(system: System, q: Array) -> tuple[Array, Array]:
    """g and g' (n, paths) at the displacements q."""
    g, slope = np.zeros_like(q), np.zeros_like(q)
    for stop in system.stops:
        overlap = np.maximum(stop.sign * q[stop.index] - stop.clearance, 0.0)
        g[stop.index] += stop.sign * stop.force(overlap)
        slope[stop.index] += np.where(overlap > 0, stop.slope(overlap), 0.0)
    return g, slope


def exact_flow_twin(system, h, q, p, draw):
    g, slope = contact(system, q)
    m = system.mass[:, None]
    flow = exact_flow(system, h)
    x = np.vstack([q, p - h * g * (1 - h**2 * slope / (12 * m))])
    x = flow.propagator @ x + lower_trapezoidal(flow.factor) @ draw(flow.factor.shape[1])
    return x[: system.n], x[system.n :]


def baoab_twin(system, h, q, p, draw):
    m, c = system.mass[:, None], system.damping / system.mass
    p = p - h * (contact(system, q)[0] + system.stiffness_matrix @ q)  # two half kicks
    q = q + h / 2 * p / m
    L = lower_trapezoidal(covariance_factor(flow_covariance(-c, 2 * system.noise_matrix, h)[1]))
    p = expm(-c * h) @ p + L @ draw(L.shape[1])
    return q + h / 2 * p / m, p


def euler_twin(system, h, q, p, draw):
    m, n = system.mass[:, None], system.n
    force = contact(system, q)[0] + system.stiffness_matrix @ q + system.damping @ (p / m)
    zero = np.zeros((n, n))
    covariance = np.block([[zero, zero], [zero, 2 * h * system.noise_matrix]])
    L = lower_trapezoidal(covariance_factor(covariance))[n:]
    return q + h * p / m, p - h * force + L @ draw(L.shape[1])


TWINS: dict[str, Step] = {
    "exact_flow": exact_flow_twin,
    "baoab": baoab_twin,
    "euler_maruyama": euler_twin,
}


def cubic(monkeypatch: pytest.MonkeyPatch) -> System:
    """A system with a contact law that somebody else has registered."""
    law = ContactLaw("cubic", 3.0, lambda x, e: x**3, lambda x, e: x**4 / 4, lambda x, e: 3 * x * x)
    monkeypatch.setitem(LAWS, law.name, law)
    contacts = (Contact(2, "both", 10.0, 0.5, law="cubic"),)
    return System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.1, 0.1], contacts=contacts)


@pytest.mark.parametrize(
    ("name", "make"),
    [
        *((name, fig6) for name in TWINS),
        ("exact_flow", linear),
        ("exact_flow", mixed),
        ("exact_flow", cubic),
        *(pytest.param(name, mixed, marks=pytest.mark.slow) for name in (*TWINS,)[1:]),
    ],
)
def test_kernel_equals_its_twin(name: str, make, monkeypatch: pytest.MonkeyPatch) -> None:
    system = make(monkeypatch) if make is cubic else make()
    assert set(SCHEMES) == set(TWINS)
    h, paths, seed = 0.02 if name == "euler_maruyama" else 0.11, 150, 977
    ensemble = Ensemble(system, SCHEMES[name], h, paths, seed, 1)
    q, p = (x.T * 3.0 for x in ensemble.phase_points())
    place(ensemble, 3.0 * ensemble.states)
    for step in range(20):
        pairs = ensemble.step.pairs
        draw = lambda r, s=step, k=pairs: normals(seed, paths, s * k, max(r, 1))[:r]  # noqa: E731
        q, p = TWINS[name](system, h, q, p, draw)
    ensemble.advance(20)
    for own, twin in zip(ensemble.phase_points(), (q, p), strict=True):
        np.testing.assert_allclose(own.T, twin, rtol=0, atol=1e-12 * np.abs(twin).max())


@pytest.mark.parametrize("dt", [0.01, 10.0])
def test_covariance_after_any_number_of_steps_is_that_of_one_long_step(dt: float) -> None:
    for system in (linear(2), mixed()):
        flow, covariance = exact_flow(system, dt), np.zeros((2 * system.n, 2 * system.n))
        E, own = flow.propagator, flow.factor @ flow.factor.T
        A, b = drift_matrix(system), diffusion_matrix(system)
        stationary = solve_continuous_lyapunov(A, -b)
        close = {"rtol": 0, "atol": 1e-12 * np.abs(stationary).max()}
        np.testing.assert_allclose(E @ stationary @ E.T + own, stationary, **close)
        for steps in range(1, 65):
            covariance = E @ covariance @ E.T + own
            if steps in (1, 7, 64):
                expected = flow_covariance(A, b, steps * dt)[1]
                np.testing.assert_allclose(
                    covariance, expected, rtol=0, atol=1e-12 * np.abs(expected).max()
                )


@pytest.mark.parametrize("dt", [1e-3, 10.0])
def test_noise_on_one_mass_of_five_and_no_noise(dt: float) -> None:
    for noise in (0.3, 0.0):
        system = System([1.0] * 5, [1.0] * 5, [0.1] * 5, [noise, 0.0, 0.0, 0.0, 0.0])
        _, covariance = flow_covariance(drift_matrix(system), diffusion_matrix(system), dt)
        L = covariance_factor(covariance)
        assert np.all(np.isfinite(L))
        np.testing.assert_allclose(L @ L.T, covariance, rtol=0, atol=1e-13 * covariance.max())
    assert L.shape[1] == 0


def test_singular_covariance_draws_as_many_normals_as_its_rank() -> None:
    X = np.array([[1.0, 2.0, 0.0], [1e-6, 0.0, 3e-6], [3.0, 6.0, 0.0], [0.0, 0.0, 0.0]])
    L = covariance_factor(X @ X.T)
    assert L.shape == (4, 2)
    np.testing.assert_allclose(L @ L.T, X @ X.T, rtol=1e-12, atol=1e-25)


@pytest.mark.parametrize("units", [(1e60, 1e15, 1.0), (1e-50, 1e2, 1e-25), (1e-3, 1e15, 1e7)])
@pytest.mark.parametrize("dt", [0.1, 3.0])
def test_the_flow_is_the_same_in_any_units(units: tuple[float, float, float], dt: float) -> None:
    one, (a, L, t) = linear(), units
    size = np.array([L, L, a * L / t, a * L / t])
    (A, C), (B, D) = (
        flow_covariance(drift_matrix(system), diffusion_matrix(system), step)
        for system, step in ((one, dt), (in_units(one, *units), t * dt))
    )
    # Some hundred roundings of numbers of size 1; doublings add up those of the covariance.
    assert np.max(np.abs(B / size[:, None] * size - A)) < 1e-13
    assert np.max(np.abs(D / size[:, None] / size - C)) < 1e-11 * np.max(C)


def midpoint(system: System, dt: float) -> LinearMap:
    """Implicit midpoint: (1 − A)⁻¹ (1 + A), A = L h/2, noise factor of (1 − A)⁻¹ 2D h (1 − A)⁻ᵀ.

    Its stationary covariance P is exact whatever h is: (1 − A) P (1 − A)ᵀ = (1 + A) P (1 + A)ᵀ +
    2D h is L P + P Lᵀ + 2D = 0, the equation of the process itself.
    """
    half, one = 0.5 * dt * drift_matrix(system), np.eye(2 * system.n)
    back = np.linalg.inv(one - half)
    noise = covariance_factor(back @ diffusion_matrix(system) @ back.T * dt)
    return LinearMap(back @ (one + half), noise)


def test_a_scheme_of_one_file_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """σ² of q and v is D/(c k) = ½; Euler's rule is off by far more at a fifth of the step."""
    toy = Scheme(name="midpoint", weak_order=2, linear_map=midpoint)
    monkeypatch.setitem(SCHEMES, toy.name, toy)

    def variances(scheme: str, dt: float):
        method = MonteCarlo(scheme=scheme, dt=dt, paths=4096, relaxations=20.0, seed=3)
        free = System([1.0], [1.0], [0.2], [0.1])
        return method.solve(free, [parse_observable("q1", 1)]).report.moments

    own, euler = variances(toy.name, 0.5), variances("euler_maruyama", 0.1)
    for name in ("q1²", "v1²"):
        assert own[name].error < 0.01 and abs(own[name].value - 0.5) < 5.0 * own[name].error
        assert abs(euler[name].value - 0.5) > 20.0 * euler[name].error
    with pytest.raises(ValueError, match="already"):
        register_scheme(toy)


Q = parse_observable("q1", 1)


def hertz(**fields) -> System:
    """One mass between Hertz stops; at 5 kT they are six times as stiff as the spring."""
    stop = Contact(1, "both", 4.0, 0.5, law="hertz")
    return System([1.0], [1.0], [0.6], [0.3], contacts=(stop,), **fields)


def small(**fields) -> MonteCarlo:
    return MonteCarlo(**{"paths": 4096, "relaxations": 10.0, **fields})


@pytest.mark.parametrize(
    ("scheme", "dt", "least"), [("euler_maruyama", 0.1, 0.6), ("exact_flow", 1.5, 0.8253)]
)
def test_an_unstable_step_ends_in_one_line(scheme: str, dt: float, least: float) -> None:
    """A step beyond the limit, 2 ζ/ω = c/k without contact, 2/ω in contact, is refused."""
    limit = stability_limit(hertz(), SCHEMES[scheme])
    with pytest.raises(InvalidInput, match=f"stability limit {least}"):
        small(scheme=scheme, dt=1.001 * least).solve(hertz(), [Q])
    with pytest.raises(NotCertified, match="unstable; use a dt below") as end:
        small(scheme=scheme, dt=dt, allow_unstable=True, relaxations=150.0).solve(hertz(), [Q])
    assert float(str(end.value).rsplit(maxsplit=1)[1]) <= min(1.01 * limit, 0.5 * dt)


def test_the_stable_step_of_eulers_rule_is_that_of_its_eigenvalues() -> None:
    system = System([2.0, 1.0], [3.0, 1.0], [0.3, 0.2], [0.1, 0.1])
    limit = stability_limit(system, SCHEMES["euler_maruyama"])

    def radius(h: float) -> float:
        step = SCHEMES["euler_maruyama"].linear_map(system, h).propagator
        return float(np.max(np.abs(np.linalg.eigvals(step))))

    assert radius(0.999 * limit) < 1.0 < radius(1.001 * limit)


def test_a_biased_step_below_the_limit_is_not_certified() -> None:
    result = small(scheme="euler_maruyama", dt=0.01, relaxations=40.0).solve(hertz(), [Q])
    assert any("standard errors" in f for f in result.densities[0].certificate.failures)


@pytest.mark.parametrize("question", ["passage", "transient", "crossings", "correlation"])
def test_motions_in_time_end_in_one_line(question: str) -> None:
    at, times = np.array([0.2]), np.array([40.0])
    own = small(dt=1.5, allow_unstable=True, time=40.0)
    asked = {"passage": (parse_limit("q1=9", 1), REST, times), "transient": (Q, REST, times, (at,))}
    words = "are unstable; use a dt below|no step of 1.5 begins in the start; use a smaller dt"
    with pytest.raises((NotCertified, NotApplicable), match=words):
        getattr(own, question)(hertz(), *asked.get(question, (Q, at)))


def test_a_mass_that_is_hotter_than_the_others_stays_within() -> None:
    """Noise on a mass that is hardly damped: T is 500 times the mean that kT is."""
    system = System([1.0, 1.0], [1.0, 1.0], [1.0, 1e-3], [0.0, 1e-3])
    assert hottest(system) == pytest.approx(1.0)
    own = small(dt=0.5, time=50.0, burn_in=2.0)
    assert own.solve(system, [parse_observable("q2", 2)]).identities


def test_motions_without_damping_or_from_far_stay_within() -> None:
    own = small(most_steps=4000)
    far = transient(hertz(), "q1", "q1=6", [0.5, 3.0], [0.0], method=own)
    assert np.all(np.isfinite(far.values))
    loose = System([1.0], [1e-4], [0.0], [0.5])
    grown = transient(loose, "q1", "rest", [100.0], [0.0], method=own)
    # Var q = (2/3) D t³ but for the soft spring, which takes a tenth of it.
    assert grown.values[0, 0] == pytest.approx((2 * np.pi * 2 / 3 * 0.5 * 1e6) ** -0.5, rel=0.3)
