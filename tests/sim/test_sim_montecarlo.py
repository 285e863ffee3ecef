"""The method: against exact densities, identities, refusals. Seeds were drawn once."""

from itertools import pairwise
from math import exp, inf, sqrt
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import solve_continuous_lyapunov
from scipy.stats import chi2
from sim_systems import exact, fig6, linear, mixed

from fpk.answer.method import Result
from fpk.answer.names import parse_observable
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.contact import Contact
from fpk.system.linear import diffusion_matrix, drift_matrix
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.sample.diagnostics import Report
from sim.sample.plan import Setup, watched
from sim.sample.simulation import simulate
from sim.sample.workers import workers_of
from sim.step.kernel import KernelKey, WatchArrays
from sim.step.schemes import SCHEMES
from sim.step.step_size import chosen_step, contact_frequency

Q2 = (parse_observable("q2", 2),)


def weight(q: float, clearance: float = 0.5) -> float:
    """exp(−2 V) of the exact system with q1 integrated out: k_eff = ½ and B = 10."""
    return exp(-2.0 * (0.25 * q * q + 4.0 * max(abs(q) - clearance, 0.0) ** 2.5))


def exact_square() -> float:
    norm = quad(weight, 0, 6, points=[0.5], epsabs=1e-13)[0]
    return quad(lambda q: q * q * weight(q), 0, 6, points=[0.5], epsabs=1e-13)[0] / norm


def block_chi_square(density: SampledDensity, clearance: float) -> float:
    """Probability of so large a χ² of 12 blocks of equal probability of |q|, by Hotelling's T²."""
    half = density.batch_values.shape[1] // 2
    e, blocks = density.edges[0][half:], 12
    np.testing.assert_allclose(density.batch_values, density.batch_values[:, ::-1], rtol=1e-12)
    norm = quad(weight, 0, 6, points=[clearance], args=(clearance,))[0]
    exact_bins = np.array([quad(weight, a, b, args=(clearance,))[0] / norm for a, b in pairwise(e)])
    group = np.minimum((np.cumsum(exact_bins) * blocks).astype(int), blocks - 1)
    join = np.equal.outer(np.arange(blocks - 1), group).astype(float)
    batches = 2.0 * density.batch_values[:, half:] * np.diff(e) @ join.T
    difference = batches.mean(axis=0) - join @ exact_bins
    covariance = np.cov(batches.T) / batches.shape[0]
    n, k = batches.shape[0], blocks - 1
    square = difference @ np.linalg.solve(covariance, difference) * (n - k) / (n - 1)
    return float(chi2.sf(square, k))


@pytest.fixture(scope="module")
def sampled() -> Result:
    return MonteCarlo(paths=8192, time=2500.0, seed=20406).solve(exact(), Q2)


def test_displacements_of_the_exact_system(sampled: Result) -> None:
    s = sampled.settings
    error = float(s["standard error of E q2²"])
    assert abs(float(s["E q2²"]) - exact_square()) < 4.0 * error
    assert error < 4e-4 * exact_square()


def test_equipartition(sampled: Result) -> None:
    s = sampled.settings
    for name in ("v1", "v2"):
        value, error = float(s[f"E {name}²"]), float(s[f"standard error of E {name}²"])
        assert abs(value - 0.5) < 4.0 * error
        assert error < 1e-3


def test_density_of_the_exact_system_and_not_of_another_clearance(sampled: Result) -> None:
    (density,) = sampled.densities
    assert isinstance(density, SampledDensity)
    assert density.certificate.certified
    assert density.certificate.tail_mass < 1e-6
    assert block_chi_square(density, 0.5) > 1e-4
    assert block_chi_square(density, 0.55) < 1e-12


def test_identities(sampled: Result) -> None:
    assert len(sampled.identities) == 5
    for identity in sampled.identities:
        assert identity.error > 0
        assert abs(identity.z) < 4.0, identity


def small(**fields: object) -> MonteCarlo:
    return MonteCarlo(**{"paths": 4096, "time": 150.0, "seed": 733, **fields})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "system",
    [
        mixed(),
        pytest.param(
            System([1.0], [1.0], [0.2], [0.1], contacts=(Contact(1, "right", 4.0, 0.0),)),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            System([1.0, 2.0], [1.0, 1.0], [0.2, 0.2], [0.2, 0.0]), marks=pytest.mark.slow
        ),
        pytest.param(linear(5), marks=pytest.mark.slow),
    ],
    ids=["mixed", "one-mass", "noise-on-one", "five"],
)
def test_other_systems_keep_their_identities(system: System) -> None:
    n = system.n
    names = ["q1", f"p{n}", "H", f"q{n},p{n}"]
    result = small().solve(system, [parse_observable(name, n) for name in names])
    assert len(result.identities) == 2 * n + 1
    for identity in result.identities:
        assert abs(identity.z) < 4.5, identity
    for density in result.densities:
        assert density.certificate.certified, density.certificate
        assert density.certificate.mass_defect < 1e-12


@pytest.mark.parametrize("dt", [0.01, 1.0, 10.0])
def test_without_contact_any_step_gives_the_gaussian(dt: float) -> None:
    system = linear(2)
    covariance = solve_continuous_lyapunov(drift_matrix(system), -diffusion_matrix(system))
    time = 20.0 if dt < 0.1 else 20.0 * max(1.0, dt) * 5
    s = small(dt=dt, time=time, burn_in=6.0).solve(system, Q2).settings
    value, error = float(s["E q2²"]), float(s["standard error of E q2²"])
    assert abs(value - covariance[1, 1]) < 4.5 * error


def test_damping_term_of_the_observed_momentum(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kinetic balance of the mass in contact holds with (h²/12) c_ik g_k/m_k only."""
    contacts = (Contact(2, "both", 10.0, 0.5),)
    system = System([1.0, 1.0], [1.0, 1.0], [0.8, 0.8], [0.4, 0.4], contacts=contacts)
    method = small(paths=8192, dt=0.2, time=400.0)
    assert abs(method.solve(system, Q2).identities[-1].z) < 4.0

    def without(*arguments: Any, **settings: Any) -> tuple[KernelKey, WatchArrays]:
        key, arrays = watched(*arguments, **settings)
        return key, arrays._replace(cross=0.0 * arrays.cross)

    monkeypatch.setattr("sim.sample.ensemble.watched", without)
    assert abs(method.solve(system, Q2).identities[-1].z) > 7.0


def test_euler_maruyama_is_visibly_biased() -> None:
    result = small(scheme="euler_maruyama", dt=0.02, seed=5).solve(exact(), Q2)
    assert isinstance(result.report, Report)
    square = result.report.moments["v2²"]
    assert square.value - 0.5 > 8.0 * square.error
    assert any("standard errors" in f for f in result.densities[0].certificate.failures)


def test_refusals() -> None:
    silent = System([1.0], [1.0], [0.1], [0.0])
    undamped = System([1.0], [1.0], [0.0], [0.1])
    q1 = parse_observable("q1", 1)
    assert "no noise" in (MonteCarlo().refusal(silent, q1) or "")
    assert "not damped" in (MonteCarlo().refusal(undamped, q1) or "")
    assert MonteCarlo().refusal(fig6(), Q2[0]) is None
    with pytest.raises(NotApplicable, match="no noise"):
        MonteCarlo().solve(silent, [q1])


def test_step_choice_and_its_limit() -> None:
    # By hand: kT = 0.03/0.12 = ¼; at 5 kT of ¼ q² + 4 (q − ½)^2.5 the mass is at q = 1.0664, where
    # the stop is as stiff as 15 √0.5664 = 11.29 and the springs as K_22 = 1: ω = 3.51 with m = 1.
    assert pytest.approx(1.25, rel=1e-3) == 0.25 * 1.0664**2 + 4.0 * 0.5664**2.5
    assert chosen_step(fig6()) == pytest.approx(0.45 / sqrt(11.29 + 1.0), rel=1e-3)
    limit = 2.0 / contact_frequency(fig6())
    for name in sorted(SCHEMES):
        with pytest.raises(InvalidInput, match="stability limit"):
            small(scheme=name, dt=1.01 * limit).solve(fig6(), Q2)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("scheme", "rk4"),
        ("paths", 10),
        ("seed", -1),
        ("seed", 2**64),
        ("threads", 0),
        ("threads", 100_000),
        ("relaxations", 0.0),
        ("most_steps", 0),
        ("time", 0.0),
        ("seconds", 0.0),
        ("dt", inf),
        ("tol", -1.0),
        ("burn_in", float("nan")),
    ],
)
def test_fields_are_checked(key: str, value: object) -> None:
    with pytest.raises(InvalidInput, match=key):
        small(**{key: value})


def test_target_error_is_met_or_the_certificate_says_so() -> None:
    calls: list[tuple[int, int, str]] = []
    met = small(tol=0.1, time=40.0).solve(exact(), Q2, progress=lambda *c: calls.append(c))
    assert met.densities[0].certificate.certified
    assert list(dict.fromkeys(what for *_, what in calls)) == ["burn-in", "simulation"]
    assert all(d <= t for d, t, _ in calls)
    missed = small(tol=1e-9, longest=0.01, time=40.0).solve(exact(), Q2)
    assert any("exceeds the tolerance" in f for f in missed.densities[0].certificate.failures)
    assert small(tol=0.1).refined().tol == 0.05


@pytest.mark.slow
def test_displacement_of_the_exact_system_to_three_parts_in_ten_thousand() -> None:
    s = MonteCarlo(paths=16384, time=8000.0, seed=61).solve(exact(), Q2).settings
    assert float(s["standard error of E q2²"]) < 1e-4 * exact_square()
    assert float(s["E q2²"]) == pytest.approx(exact_square(), rel=3e-4)


@pytest.mark.slow
def test_weak_order_of_the_displacement_in_the_step() -> None:
    """At large steps, where the bias of the plain mean stands above the sampling error.

    The error of the order is that of the two biases; the stability limit is 0.55, and higher orders
    add to the fourth.
    """
    steps, biases, errors = (0.32, 0.42), [], []
    scheme = SCHEMES["exact_flow"]
    for dt in steps:
        method = MonteCarlo(paths=65536, seed=97)
        setup = Setup(method, exact(), (), scheme, dt=dt, time=6000.0)
        with workers_of(None, 2) as workers:
            square = simulate(setup, workers=workers).report.moments["q2²"]
        biases.append(square.value / exact_square() - 1.0)
        errors.append(square.error / abs(square.value - exact_square()))
    wide = np.log(steps[1] / steps[0])
    order, error = np.log(biases[1] / biases[0]) / wide, np.hypot(*errors) / wide
    assert error < 0.35
    assert order > SCHEMES["exact_flow"].weak_order - 0.5


def test_point_values_between_bin_centres(sampled: Result) -> None:
    # Points at no particular place in their bins. Smoothing makes z dependent over eleven bins, so
    # that 200 points are some 40 independent ones: rms 1 ± 0.11, and 1.6 is beyond five of these.
    norm = 2.0 * quad(weight, 0.0, 4.0, points=[0.5])[0]
    x = np.linspace(-1.0, 1.0, 200) + 0.00123

    def rms_z(shift: float) -> float:
        value, error = sampled.densities[0].at(x)
        p = np.array([weight(abs(point + shift)) for point in x]) / norm
        return float(np.sqrt(np.mean(((value - p) / error) ** 2)))

    assert rms_z(0.0) < 1.6
    assert rms_z(0.02) > 1.6
