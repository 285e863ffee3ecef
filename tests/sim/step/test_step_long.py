"""Small steps near a stop only: the same law as small steps everywhere. Seeds were drawn once."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from sim_systems import fig6, linear, mixed, place, slow
from test_step_random import box_muller, word
from test_step_schemes import contact

from fpk.system.contact import Contact
from fpk.system.damping import DampingTerm
from fpk.system.linear import diffusion_matrix, drift_matrix, flow_covariance
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.sample.diagnostics import moment_products
from sim.sample.ensemble import Ensemble
from sim.sample.plan import (
    LARGEST_NORMAL,
    LONG_COST,
    bends,
    noise_reach,
    relative_cost,
    with_long_steps,
)
from sim.step.random import normals
from sim.step.schemes import SCHEMES, exact_flow, lower_trapezoidal
from sim.step.step_size import chosen_step, sampling_interval

Array = NDArray[np.float64]
EXACT_FLOW = SCHEMES["exact_flow"]


def stiff(stiffness: float = 1e5) -> System:
    return fig6(stiffness=stiffness)


def one() -> System:
    return System([2.0], [1.0], [0.2], [0.1], contacts=(Contact(1, "right", 3e3, 0.3),))


def near(system: System, H: float, x: Array) -> NDArray[np.bool_]:
    """Return which states x (2n, paths) may touch a stop within H; ten lines of NumPy."""
    mass = np.array([s.index for s in system.stops])
    row, bend = exact_flow(system, H).propagator, bends(system, H, mass)
    reach, found = noise_reach(system, H, mass), np.zeros(x.shape[1], bool)
    for k, stop in enumerate(system.stops):
        d = stop.sign
        furthest = np.maximum(d * x[stop.index], d * (row[stop.index] @ x) + reach[k])
        found |= furthest + bend[k] @ abs(x) >= stop.clearance
    return found


def own_normals(seed: int, paths: int, counter: int, pairs: int) -> Array:
    """Return (2 pairs, paths) normals whose radii and angles are halves of a path's own word."""
    found = []
    for pair in range(pairs):
        words = np.array([word(seed, path, counter + pair) for path in range(paths)], np.uint64)
        halves = (words & np.uint64(0xFFFFFFFF), words >> np.uint64(32))
        found += [*box_muller(*(h.astype(np.int64) for h in halves))]
    return np.array(found)


@pytest.mark.parametrize("make", [stiff, *map(slow, (fig6, mixed, one))])
def test_kernel_equals_its_twin(make) -> None:
    """To 2e-5 of the largest number: single-precision normals, within 2e-6 each, in 3 × 8 steps.

    With mixed signs of the start every kind of stop is near for some lanes and far for others.
    """
    system, small, paths, seed = make(), 8, 150, 4411
    n, h = system.n, min(0.02, chosen_step(system))
    ensemble = Ensemble(system, replace(EXACT_FLOW, small=small), small * h, paths, seed, 1)
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
        z = normals(seed, paths, step * words, 2 * pairs)[: far_L.shape[1]]
        y = long.propagator @ x + far_L @ z
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
    x = x[:, ~near(system, H, x)]
    assert x.shape[1] > 300
    short, mean, start = exact_flow(system, H / 64), x.copy(), x.copy()
    mass = np.array([s.index for s in system.stops])
    end, room = (exact_flow(system, H).propagator @ x)[mass], bends(system, H, mass) @ abs(x)
    for t in range(1, 65):
        z = rng.normal(size=(short.factor.shape[1], x.shape[1]))
        x, mean = short.propagator @ x + short.factor @ z, short.propagator @ mean
        for stop in system.stops:
            assert np.all(stop.sign * x[stop.index] < stop.clearance)
        chord = start[mass] + (end - start[mass]) * t / 64
        assert np.all(abs(mean[mass] - chord) <= room)
    assert np.any(abs(mean[mass] - start[mass]) > 0.1 * size[0])


def test_the_noise_of_a_long_step_is_a_tail_of_its_normal_law() -> None:
    """a/σ(H) is 6.66 or more: by Rice a s/H is crossed with a probability of 1.5e-11 at most."""
    for system in (stiff(), mixed(), one()):
        for H in np.array([0.05, 0.5, 1.0]) * sampling_interval(system):
            covariance = flow_covariance(drift_matrix(system), diffusion_matrix(system), H)[1]
            masses = np.array(system.contact_masses)
            deviations = noise_reach(system, H, masses) / np.sqrt(np.diag(covariance)[masses])
            assert np.all(deviations >= 6.66)
    z = normals(5, 1 << 18, 0, 2)
    assert np.hypot(*z).max() < LARGEST_NORMAL
    assert pytest.approx(np.sqrt(-2.0 * np.log(2.0**-32)), rel=1e-5) == LARGEST_NORMAL


def test_choice_of_the_long_step() -> None:
    system = stiff()
    h = chosen_step(system)
    scheme, H, words = with_long_steps(system, EXACT_FLOW, h)
    small, part = scheme.small, relative_cost(system, h, scheme.small)
    assert small * h == H > h and scheme.name == EXACT_FLOW.name
    # What most_steps counts: long steps are a part of the cost, the near ones another.
    assert LONG_COST / small < part < 0.8
    capped = MonteCarlo(paths=4096, most_steps=400, burn_in=0.1).solve(system, ()).settings
    assert capped["limited_by"] == "most_steps"
    most = 400.0 * h / part
    assert most <= float(capped["time"]) < most + 20.0 * H * int(capped["stride"])
    assert small >= 4 and small * h <= sampling_interval(system) and str(small) in words
    assert with_long_steps(system, EXACT_FLOW, 0.5 * h)[0].small >= small
    damped = replace(system, damping_terms=(DampingTerm(1, 1, 0.05, q=((1, 2),)),))
    for other, name, why in (
        (linear(2), "exact_flow", "no contact"),
        (damped, "exact_flow", "damping terms"),
        (system, "baoab", "needs the small step"),
        (fig6(), "exact_flow", ""),
    ):
        step = chosen_step(other)
        scheme, long, words = with_long_steps(other, SCHEMES[name], step)
        assert scheme.small == 1 and long == step and why in words
