"""This program, one thread: its exact flow, and the constant A of L1 = A/√(paths × time)."""

import argparse
import json
import sys
from pathlib import Path
from time import process_time

import numpy as np

sys.path.append(str(Path(__file__).resolve().parent.parent))

from accuracy import error_against_time, exact_scene
from problem import EDGES, Array, Chain, judged
from trial import (
    BURN_IN,
    Setting,
    begun,
    density_bias,
    described,
    nanoseconds,
    stride,
    version_of,
)

from fpk.answer.bins import BinAxis
from fpk.answer.names import parse_observable
from sim.sample.ensemble import Ensemble
from sim.sample.histogram import Histogram
from sim.step.schemes import SCHEMES

SETTINGS = (
    Setting("exact_flow", 0.45, 4, 8192, 1.0),
    Setting("exact_flow", 0.3, 4, 8192, 4.0),
    Setting("exact_flow", 0.25, 4, 8192, 8.0),
    Setting("baoab", 0.3, 2, 8192, 1.0),
    Setting("baoab", 0.1, 2, 8192, 4.0),
)
TIME = 2500.0
"""Time of a path sampled for each second of ``Setting.seconds``."""


class Walked:
    """The ensemble as a walk that observes nothing."""

    def __init__(self, setting: Setting, chain: Chain, start: Array, seed: int) -> None:
        """Begin; the ensemble has the same chain and draws a start of its own."""
        scheme = SCHEMES[setting.scheme]
        self.ensemble = Ensemble(exact_scene(), scheme, setting.step, setting.paths, seed, 1)

    def advance(self, steps: int) -> None:
        """Make so many steps."""
        self.ensemble.advance(steps, stride=0)

    def states(self) -> Array:
        """Return the states (4, paths)."""
        return self.ensemble.states.transpose(1, 0, 2).reshape(4, -1)


def tried(setting: Setting, sampling: float) -> dict:
    """Return the line of one setting."""
    walk, first = begun(setting, Walked, judged())
    ensemble, every = walk.ensemble, stride(setting)
    ensemble.advance(round(BURN_IN / setting.step), stride=0)
    ns = nanoseconds(walk, setting)
    ensemble.watch((Histogram(parse_observable("q2", 2), (BinAxis(EDGES),)),))
    ensemble.advance(round(TIME * setting.seconds / setting.step), stride=every)
    counts = np.array([ensemble.counts[::2].sum(axis=0), ensemble.counts[1::2].sum(axis=0)])
    about = {"first": first, "lost": 0.0}
    return described(setting, ns, sampling, about, density_bias(counts), "")


def sampling_constant() -> dict:
    """Return the line of A, the mean of L1 √(paths × time) over four levels, and its scatter."""
    begin = process_time()
    rows, _ = error_against_time(levels=5, seeds=4)
    found = [float(r["L1"]) * np.sqrt(float(r["time"]) * 8192) for r in rows[1:]]
    scatter = float(np.std(found, ddof=1))
    last = {"L1": float(rows[-1]["L1"]), "seconds": float(rows[-1]["seconds"])}
    spent = process_time() - begin
    return {
        "kind": "sampling",
        "A": float(np.mean(found)),
        "scatter": scatter,
        **last,
        "spent": spent,
    }


def main() -> None:
    """Print the lines; that of A comes first."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--smallest", action="store_true", help="the first setting, briefly")
    parser.add_argument("--sampling", type=float, help="found here: taken for the same face only")
    arguments = parser.parse_args()
    about = {"peer": "vibro-fpk", "version": version_of("vibro-fpk")}
    line = sampling_constant()
    print(json.dumps(about | line), flush=True)
    for setting in SETTINGS[:1] if arguments.smallest else SETTINGS:
        print(json.dumps(about | tried(setting, line["A"])), flush=True)


if __name__ == "__main__":
    main()
