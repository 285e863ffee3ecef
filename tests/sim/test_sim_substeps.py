"""Small steps near a stop only: the same law as small steps everywhere. Seeds were drawn once."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm
from sim_systems import fig6, linear, mixed, place
from test_sim_random import word
from test_sim_schemes import contact

from fpk.answer.bins import BinAxis
from fpk.answer.method import Identity
from fpk.answer.names import parse_observable
from fpk.system.contact import Contact
from fpk.system.damping import DampingTerm
from fpk.system.linear import diffusion_matrix, drift_matrix
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.sample.diagnostics import batch_moments, moment_identities, moment_products
from sim.sample.ensemble import Ensemble
from sim.sample.histogram import Histogram
from sim.sample.plan import (
    LARGEST_NORMAL,
    LONG_COST,
    bends,
    cost,
    noise_reach,
    step_arrays,
    watched,
    with_long_steps,
)
from sim.step.arrays import LANES
from sim.step.random import normals
from sim.step.schemes import SCHEMES, Scheme, exact_flow, flow_covariance, lower_trapezoidal
from sim.step.step_size import chosen_step, sampling_interval

Array = NDArray[np.float64]
EXACT_FLOW = SCHEMES["exact_flow"]


def stiff(stiffness: float = 1e5) -> System:
    contacts = (Contact(2, "both", stiffness, 0.5),)
    return System([1.0, 1.0], [1.0, 1.0], [0.08, 0.04], [0.01, 0.02], contacts=contacts)


def one(side: str = "right") -> System:
    return System([2.0], [1.0], [0.2], [0.1], contacts=(Contact(1, side, 3e3, 0.3),))


def longer(small: int) -> Scheme:
    return replace(EXACT_FLOW, small=small)


def near(system: System, H: float, x: Array) -> NDArray[np.bool_]:
    """Return which states x (2n, paths) may touch a stop within H; ten lines of NumPy."""
    mass = np.array([s.index for s in system.stops])
    row, bend = exact_flow(system, H).propagator, bends(system, H, mass)
    reach, found = noise_reach(system, H, mass), np.zeros(x.shape[1], bool)
    for k, stop in enumerate(system.stops):
        d = 1.0 if stop.side == "right" else -1.0
        furthest = np.maximum(d * x[stop.index], d * (row[stop.index] @ x) + reach[k])
        found |= furthest + bend[k] @ abs(x) >= stop.clearance
    return found


def own_normals(seed: int, paths: int, counter: int, pairs: int) -> Array:
    """Return (2 pairs, paths) normals whose radii and angles are halves of a path's own word."""
    found = []
    for pair in range(pairs):
        words = np.array([word(seed, path, counter + pair) for path in range(paths)], np.uint64)
        radius, angle = words & np.uint64(0xFFFFFFFF), words >> np.uint64(32)
        r = np.sqrt(-2.0 * np.log((radius | np.uint64(1)).astype(float) / 2.0**32))
        r *= np.where(angle >> np.uint64(31), -1.0, 1.0)
        theta = ((angle & np.uint64(0x7FFFFF)).astype(float) / 2**22 - 1.0) * np.pi / 2
        found += [r * np.cos(theta), r * np.sin(theta)]
    return np.array(found)


@pytest.mark.parametrize(
    "make",
    [stiff, fig6]
    + [pytest.param(make, marks=pytest.mark.slow) for make in (mixed, one, lambda: one("both"))],
    ids=["stiff", "fig6", "mixed", "1", "2"],
)
def test_kernel_equals_its_twin(make) -> None:
    """To 2e-5 of the largest number: single-precision normals, within 2e-6 each, in 3 × 8 steps."""
    system, small, paths, seed = make(), 8, 150, 4411
    n, h = system.n, min(0.02, chosen_step(system))
    ensemble = Ensemble(system, longer(small), small * h, paths, seed, 1)
    ensemble.watch((), moment_products(n))  # the kernel of the other tests
    rng, begin = np.random.default_rng(3), 2
    states = 1.0 * ensemble.states
    states[:, :n] = rng.uniform(-0.5, 0.5, states[:, :n].shape)
    place(ensemble, states)
    ensemble.advance(begin, stride=0)
    x = np.vstack([y.T for y in ensemble.phase_points()])
    short, long = exact_flow(system, h), exact_flow(system, small * h)
    L, far_L = lower_trapezoidal(short.factor), lower_trapezoidal(long.factor)
    pairs, words, m = ensemble.step.pairs, ensemble.step.words, system.mass[:, None]
    chosen = 0
    for step in range(begin, begin + 3):
        close = near(system, small * h, x)
        chosen += close.sum()
        y = (
            long.propagator @ x
            + far_L @ normals(seed, paths, step * words, 2 * pairs)[: far_L.shape[1]]
        )
        for t in range(small):
            z = own_normals(seed, paths, step * words + pairs * (t + 1), pairs)
            g, slope = contact(system, x[:n])
            x[n:] -= h * g * (1 - h**2 * slope / (12 * m))
            x = short.propagator @ x + L @ z[: L.shape[1]]
        x = np.where(close, x, y)
    assert 0 < chosen < 3 * paths
    ensemble.advance(3, stride=0)
    found = np.vstack([y.T for y in ensemble.phase_points()])
    np.testing.assert_allclose(found, x, rtol=0, atol=2e-5 * np.abs(x).max())


def observed(threads: int, chunks: tuple[int, ...], paths: int = 5 * LANES - 17) -> Ensemble:
    system = stiff(1e3)
    ensemble = Ensemble(system, longer(8), 0.16, paths, 31, threads)
    edges = (BinAxis(np.linspace(-1.0, 1.0, 65)),)
    histograms = tuple(
        Histogram(parse_observable(name, 2), edges * (1 + name.count(",")))
        for name in ("q2", "p2", "q2,p2")
    )
    ensemble.watch(histograms, moment_products(2))
    ensemble.advance(20, stride=0)
    for steps in chunks:
        ensemble.advance(steps, stride=3)
    return ensemble


@pytest.mark.parametrize(("threads", "chunks"), [(1, (60,)), (2, (60,)), (2, (1, 7, 20, 32))])
def test_bitwise_the_same_for_any_threads_and_chunks(threads: int, chunks: tuple[int, ...]) -> None:
    reference, other = observed(1, (30, 30)), observed(threads, chunks)
    np.testing.assert_array_equal(reference.states, other.states)
    np.testing.assert_array_equal(reference.counts, other.counts)
    np.testing.assert_array_equal(reference.batch_means(), other.batch_means())
    more = observed(1, (60,), 9 * LANES)
    np.testing.assert_array_equal(more.phase_points()[0][: other.paths], other.phase_points()[0])


@pytest.mark.parametrize("make", [stiff, mixed, one], ids=["stiff", "mixed", "one"])
def test_far_trajectories_do_not_touch(make) -> None:
    """Motion in 64 short steps: none of those that are far does, 1.4e-11 each at most.

    The mean motion and the noise of its end keep within the stated bounds, too.
    """
    system, n = make(), make().n
    H = 0.5 * sampling_interval(system)
    rng = np.random.default_rng(8)
    size = np.sqrt(np.concatenate([np.diag(np.linalg.inv(system.stiffness_matrix)), system.mass]))
    x = rng.normal(size=(2 * n, 40_000)) * size[:, None]
    far = ~near(system, H, x)
    x = x[:, far]
    assert x.shape[1] > 300
    short, mean, start = exact_flow(system, H / 64), x.copy(), x.copy()
    mass = np.array([s.index for s in system.stops])
    end, room = (exact_flow(system, H).propagator @ x)[mass], bends(system, H, mass) @ abs(x)
    for t in range(1, 65):
        z = rng.normal(size=(short.factor.shape[1], x.shape[1]))
        x, mean = short.propagator @ x + short.factor @ z, short.propagator @ mean
        for stop in system.stops:
            sign = 1.0 if stop.side == "right" else -1.0
            assert np.all(sign * x[stop.index] < stop.clearance)
        chord = start[mass] + (end - start[mass]) * t / 64
        assert np.all(abs(mean[mass] - chord) <= room)
    assert np.any(abs(mean[mass] - start[mass]) > 0.1 * size[0])


@pytest.mark.parametrize("share", [0.05, 0.5, 1.0])
@pytest.mark.parametrize(
    "make",
    [stiff, pytest.param(mixed, marks=pytest.mark.slow), one],
    ids=["stiff", "mixed", "one"],
)
def test_crossings_within_a_long_step_by_rice(make, share: float) -> None:
    """Expected crossings of a s/H by the noise: the tail at a/σ(H), which is 6.66 or more."""
    system = make()
    H, drift, diffusion = (
        share * sampling_interval(system),
        drift_matrix(system),
        diffusion_matrix(system),
    )
    for i in system.contact_masses:
        a = noise_reach(system, H, np.array([i]))[0]
        deviations = a / np.sqrt(flow_covariance(drift, diffusion, H)[1][i, i])
        assert deviations >= 6.66
        times, rates = np.linspace(0.02, 1.0, 200) * H, []
        for s in times:
            C, v = flow_covariance(drift, diffusion, s)[1], i + system.n
            m, level = system.mass[i], a * s / H
            mean = C[i, v] / m / C[i, i] * level - a / H
            spread = np.sqrt(C[v, v] / m**2 - (C[i, v] / m) ** 2 / C[i, i])
            upwards = mean * norm.cdf(mean / spread) + spread * norm.pdf(mean / spread)
            rates.append(upwards * norm.pdf(level / np.sqrt(C[i, i])) / np.sqrt(C[i, i]))
        crossings = np.trapezoid(rates, times)
        # A long step's σ(s) grows more slowly than s^1.5, so that Y' is less sure to be upwards.
        assert crossings < 1.5e-11
        assert share > 0.1 or crossings < 1.1 * norm.sf(
            a / np.sqrt(flow_covariance(drift, diffusion, H)[1][i, i])
        )


def test_largest_normal() -> None:
    z = normals(5, 1 << 18, 0, 2)
    assert np.hypot(*z).max() < LARGEST_NORMAL
    assert pytest.approx(np.sqrt(-2.0 * np.log(2.0**-32)), rel=1e-5) == LARGEST_NORMAL


def test_a_force_at_an_observed_time_is_that_of_a_small_step() -> None:
    """Whoever is in contact was near one long step before: the processor's h is its own."""
    system, small, touched = stiff(1e3), 8, 0
    ensemble = Ensemble(system, longer(small), small * 0.02, 20 * LANES, 12, 1)
    ensemble.watch((), moment_products(2))
    ensemble.advance(40, stride=0)
    for _ in range(60):
        before = near(system, small * 0.02, np.vstack([y.T for y in ensemble.phase_points()]))
        ensemble.advance(1, stride=0)
        inside = abs(ensemble.phase_points()[0][:, 1]) > 0.5
        touched += inside.sum()
        assert np.all(before[inside])
    assert touched > 1000


def figures(
    system: System, small: int, *, paths: int, time: float, seed: int, burn_in: float = 600.0
) -> tuple[Array, Array, tuple[Identity, ...]]:
    """Return the batches of the time in contact and of E q2², and the moment identities."""
    h = chosen_step(system)
    ensemble = Ensemble(system, longer(small), small * h, paths, seed, 2)
    edges = (BinAxis(np.array([-0.5, 0.5])),)
    stride = max(1, round(0.1 / (small * h)))
    ensemble.watch((Histogram(parse_observable("q2", 2), edges),), moment_products(2))
    ensemble.advance(round(burn_in / (small * h)), stride=0)
    ensemble.advance(round(time / (small * h)), stride=stride)
    inside = ensemble.counts[:, 0] / ensemble.counts.sum(axis=1)
    means = ensemble.batch_means()
    square = batch_moments(system, means)["q", 1, "q", 1]
    return 1.0 - inside, square, moment_identities(system, means)


def z_of(a: Array, b: Array) -> float:
    error = np.hypot(a.std(ddof=1) / np.sqrt(a.size), b.std(ddof=1) / np.sqrt(b.size))
    return float(abs(a.mean() - b.mean()) / error)


def test_the_same_law_as_uniform_steps() -> None:
    """Time in contact, E q2², identities: |z| below 4.5 of 7 figures, false alarm 5e-5.

    Energy decays at the rate 0.04 or faster: e⁻⁸ of the start's deviation is left after a burn-in
    of 200, a twentieth of a standard error, and as much of it in either sample.
    """
    system, run = stiff(1e3), {"paths": 8192, "time": 150.0, "burn_in": 200.0}
    uniform = figures(system, 1, **run, seed=71)
    some = figures(system, 8, **run, seed=72)
    assert z_of(uniform[0], some[0]) < 4.5
    assert z_of(uniform[1], some[1]) < 4.5
    assert max(abs(i.z) for i in some[2]) < 4.5
    assert z_of(uniform[0], figures(stiff(1.1e3), 8, **run, seed=73)[0]) > 5.0


@pytest.mark.slow
def test_time_in_contact_of_a_very_stiff_stop() -> None:
    """B = 1e5: right to 0.3 % with its error below a third of that; E q2² and identities, too."""
    system = stiff()
    uniform = figures(system, 1, paths=8192, time=1500.0, seed=74)
    some = figures(system, 32, paths=16384, time=3000.0, seed=75)
    assert abs(some[0].mean() / uniform[0].mean() - 1.0) < 3e-3
    assert some[0].std(ddof=1) / np.sqrt(some[0].size) < 1e-3 * some[0].mean()
    assert z_of(uniform[0], some[0]) < 4.0 and z_of(uniform[1], some[1]) < 4.0
    assert max(abs(i.z) for i in some[2]) < 4.0


def test_choice_of_the_long_step() -> None:
    system = stiff()
    h = chosen_step(system)
    scheme, H, words = with_long_steps(system, EXACT_FLOW, h)
    assert scheme.small * h == H > h and scheme.name == EXACT_FLOW.name
    # What most_steps counts: long steps are a part of the cost, the near ones another.
    assert cost(system, h, scheme.small) > LONG_COST / scheme.small
    assert cost(system, h, scheme.small) < 0.8
    capped = MonteCarlo(paths=4096, most_steps=400, burn_in=0.1).solve(system, ())
    assert capped.settings["limited_by"] == "most_steps"
    most = 400.0 * h / cost(system, h, scheme.small)
    assert most <= float(capped.settings["time"]) < most + 20.0 * H * int(capped.settings["stride"])
    assert with_long_steps(fig6(), EXACT_FLOW, 0.1)[:2] == (EXACT_FLOW, 0.1)
    small = scheme.small
    assert small >= 4 and small * h <= sampling_interval(system) and str(small) in words
    assert with_long_steps(system, EXACT_FLOW, 0.5 * h)[0].small >= small
    term = DampingTerm(1, 1, 0.05, q=((1, 2),))
    damped = System(
        [1.0, 1.0], [1.0, 1.0], [0.08, 0.04], [0.01, 0.02],
        contacts=system.contacts, damping_terms=(term,),
    )  # fmt: skip
    for other, name, why in (
        (linear(2), "exact_flow", "no contact"),
        (damped, "exact_flow", "damping terms"),
        (system, "baoab", "needs the small step"),
        (fig6(), "exact_flow", ""),
    ):
        scheme, _, words = with_long_steps(other, SCHEMES[name], chosen_step(other))
        assert scheme.small == 1 and why in words


def test_uniform_steps_have_no_arrays_for_them() -> None:
    step = step_arrays(fig6(), EXACT_FLOW, 0.1)
    assert step.small == 1 and step.words == step.pairs
    assert not watched(fig6(), EXACT_FLOW, step, (), ())[0].substeps
    step = step_arrays(stiff(), longer(16), 0.048)
    assert watched(stiff(), EXACT_FLOW, step, (), ())[0].substeps
    assert step.words == 17 * step.pairs and step.dt == 0.003
    assert step.after.shape == (1, 4)
