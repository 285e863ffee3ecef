"""A scene with a closed form, and the error against it as the sampled time grows."""

from itertools import pairwise
from math import exp
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad

from fpk.answer.bins import BinAxis
from fpk.answer.names import parse_observable
from fpk.system.contact import Contact
from fpk.system.system import System
from sim.sample.ensemble import Ensemble
from sim.sample.histogram import Histogram
from sim.step.schemes import SCHEMES
from sim.step.step_size import chosen_step

Row = dict[str, str | int | float]


def exact_scene() -> System:
    """Return fig6's chain with c_i/D_i = 2 for both: its density is exp(−2 H), so that errors are
    against a closed form."""
    contacts = (Contact(2, "both", 10.0, 0.5),)
    return System([1.0, 1.0], [1.0, 1.0], [0.2, 0.4], [0.1, 0.2], contacts=contacts)


EDGES = np.linspace(-1.6, 1.6, 65)
"""Bins of p(q2); beyond them is one bin more."""


def probabilities() -> NDArray[np.float64]:
    """Return the exact probability of each bin of ``EDGES`` and, last, beyond them."""

    def weight(q: float) -> float:
        return exp(-2.0 * (0.25 * q * q + 4.0 * max(abs(q) - 0.5, 0.0) ** 2.5))

    norm = 2.0 * quad(weight, 0, 6, points=[0.5])[0]
    inside = np.array([quad(weight, a, b)[0] / norm for a, b in pairwise(EDGES)])
    return np.append(inside, 1.0 - inside.sum())


def error_against_time(*, levels: int = 6, seeds: int = 4) -> tuple[list[Row], float]:
    """Return mean L1 errors of p(q2) in 64 bins against wall time, and the slope of their logs.

    Burnt in before; each level samples four times as long. Means of ``seeds`` runs.
    """
    system, exact = exact_scene(), probabilities()
    dt = chosen_step(system)
    stride, rows = max(1, round(0.4 / dt)), []
    found = np.zeros((levels, seeds, 2))
    for seed in range(seeds):
        ensemble = Ensemble(system, SCHEMES["exact_flow"], dt, 8192, 100 + seed, 1)
        ensemble.advance(round(60.0 / dt))
        for level in range(levels):
            ensemble.watch((Histogram(parse_observable("q2", 2), (BinAxis(EDGES),)),))
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
