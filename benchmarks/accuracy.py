"""Time for an accuracy: the steps that a bias allows, plain NumPy at them, error against time."""

import sys
from importlib.util import find_spec
from itertools import pairwise
from math import exp
from time import perf_counter, process_time

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad

from fpk.contact import Contact
from fpk.observable import parse_observable
from fpk.system import System
from sim.ensemble import Ensemble
from sim.histogram import Histogram
from sim.montecarlo import MonteCarlo
from sim.scheme import SCHEMES
from sim.step_size import chosen_step

Array = NDArray[np.float64]
Row = dict[str, str | int | float]

BIAS = 1e-3
"""Relative bias of E q2² that the step of every competitor is to leave."""

VISIBLE_STEPS = {"exact_flow": 0.45, "baoab": 0.3, "euler_maruyama": 0.01}
"""Steps at which the bias of each scheme stands far above a sampling error of some 3e-4."""

OTHERS = ("sdeint", "diffrax", "jitcsde")


def exact_scene() -> System:
    """Return fig6's chain with c_i/D_i = 2 for both: its density is exp(−2 H), so that errors are
    against a closed form."""
    contacts = (Contact(1, "both", 10.0, 0.5),)
    return System([1.0, 1.0], [1.0, 1.0], [0.2, 0.4], [0.1, 0.2], contacts=contacts)


def _weight(q: float) -> float:
    return exp(-2.0 * (0.25 * q * q + 4.0 * max(abs(q) - 0.5, 0.0) ** 2.5))


def exact_square() -> float:
    """Return E q2² of ``exact_scene``."""
    norm = quad(_weight, 0, 6, points=[0.5], epsabs=1e-13)[0]
    return quad(lambda q: q * q * _weight(q), 0, 6, points=[0.5], epsabs=1e-13)[0] / norm


def allowed_step(name: str) -> tuple[float, float, float]:
    """Return the step of bias ``BIAS``, by a measured bias and the order; that bias, its error."""
    dt, scheme = VISIBLE_STEPS[name], SCHEMES[name]
    run = MonteCarlo(paths=16384, time=1500.0, dt=dt, scheme=name, seed=41)
    s = run.solve(exact_scene(), (parse_observable("q2", 2),)).settings
    bias = float(s["E q2²"]) / exact_square() - 1.0
    error = float(s["standard error of E q2²"]) / exact_square()
    return dt * (BIAS / abs(bias)) ** (1.0 / scheme.weak_order), bias, error


def numpy_nanoseconds(name: str, *, paths: int = 8192, steps: int = 200) -> float:
    """Return ns per particle-step of BAOAB or Euler-Maruyama written in whole-array NumPy."""
    system, rng, h = exact_scene(), np.random.default_rng(1), 0.01
    K, c = system.stiffness_matrix, np.diag(system.damping)[:, None]
    decay = np.exp(-c * h)
    diffusion = 2.0 * np.diag(system.noise_matrix)[:, None]
    thermal, kicks = np.sqrt(diffusion / (2.0 * c) * (1.0 - decay**2)), np.sqrt(diffusion * h)
    q, p, times = np.zeros((2, paths)), np.zeros((2, paths)), []
    for _ in range(5):
        start = process_time()
        for _ in range(steps):
            force = K @ q
            overlap = np.maximum(np.abs(q[1]) - 0.5, 0.0)
            force[1] += np.sign(q[1]) * 10.0 * overlap * np.sqrt(overlap)
            z = rng.standard_normal((2, paths))
            if name == "baoab":
                p -= h * force
                q += 0.5 * h * p
                p = decay * p + thermal * z
                q += 0.5 * h * p
            else:
                q, p = q + h * p, p - h * (force + c * p) + kicks * z
        times.append(process_time() - start)
    return 1e9 * min(times) / (paths * steps)


def kernel_nanoseconds(name: str, *, paths: int = 8192, steps: int = 400) -> float:
    """Return ns per particle-step of the compiled kernel on one thread, nothing observed."""
    ensemble, times = Ensemble(exact_scene(), SCHEMES[name], 0.01, paths, 1, 1), []
    ensemble.advance(20)
    for _ in range(5):
        start = process_time()
        ensemble.advance(steps)
        times.append(process_time() - start)
    return 1e9 * min(times) / (paths * steps)


def time_for_accuracy() -> list[Row]:
    """Return ns per particle and unit time at the step of each scheme, compiled and in NumPy."""
    rows: list[Row] = []
    for name in sorted(VISIBLE_STEPS):
        dt, bias, error = allowed_step(name)
        dt = min(dt, VISIBLE_STEPS[name])
        makers = {"this program": kernel_nanoseconds} | (
            {} if name == "exact_flow" else {"NumPy": numpy_nanoseconds}
        )
        for maker, measure in makers.items():
            ns = measure(name)
            rows.append(
                {"scheme": name, "by": maker, "bias": bias, "bias error": error, "dt": dt,
                 "ns": ns, "ns_time": ns / dt}
            )  # fmt: skip
    missing = [name for name in OTHERS if find_spec(name) is None]
    print(f"left out, not installed: {', '.join(missing) or 'none'}", file=sys.stderr)
    print("left out, no driver here: sdeint, diffrax, jitcsde where installed", file=sys.stderr)
    return rows


def error_against_time(*, levels: int = 6, seeds: int = 4) -> tuple[list[Row], float]:
    """Return mean L1 errors of p(q2) in 64 bins against wall time, and the slope of their logs.

    Burnt in before; each level samples four times as long. Means of ``seeds`` runs.
    """
    system, edges = exact_scene(), np.linspace(-1.6, 1.6, 65)
    norm = 2.0 * quad(_weight, 0, 6, points=[0.5])[0]
    exact = np.array([quad(_weight, a, b)[0] / norm for a, b in pairwise(edges)])
    exact = np.append(exact, 1.0 - exact.sum())
    dt = chosen_step(system)
    stride, rows = max(1, round(0.4 / dt)), []
    found = np.zeros((levels, seeds, 2))
    for seed in range(seeds):
        ensemble = Ensemble(system, SCHEMES["exact_flow"], dt, 8192, 100 + seed, 1)
        ensemble.advance(round(60.0 / dt))
        for level in range(levels):
            ensemble.watch((Histogram(parse_observable("q2", 2), (edges,)),))
            ensemble.advance(stride, stride=stride)  # compiled, when the clock starts
            start = perf_counter()
            ensemble.advance(stride * 10 * 4**level, stride=stride)
            found[level, seed, 0] = perf_counter() - start
            counts = ensemble.counts.sum(axis=0)
            found[level, seed, 1] = np.abs(counts / counts.sum() - exact).sum()
    for level in range(levels):
        seconds, error = found[level].mean(axis=0)
        rows.append({"time": 10 * 4**level * stride * dt, "seconds": seconds, "L1": error})
    logs = np.log([[float(r["seconds"]), float(r["L1"])] for r in rows])
    return rows, float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0])
