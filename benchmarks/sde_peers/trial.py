"""What every package's script shares: how a scheme is tried, timed and judged, and its lines.

A script lists its settings and says how a walk is made of one; ``measure_all`` prints JSON lines of
the kind ``scheme``, one scheme at one step: the keys peer, version, kind, scheme, step, order,
paths, ns (per particle-step), first (seconds of the first call, compilation in it), lost (share of
paths), L1 (of p(q2), the sampling noise taken off) and L1_error; allowed (the step at which L1 is
``WANTED``), ns_time (per particle and unit time there), seconds (until the noise is ``WANTED``,
too); note.

Times are of the processor, one core: what else the machine does is not in them.
"""

import os

os.environ.update(
    OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1", NUMBA_NUM_THREADS="1"
)

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from time import process_time
from typing import Protocol

import numpy as np

sys.path.append(str(Path(__file__).resolve().parent.parent / "peers"))

from measure import need as need  # the scripts of the packages import it from here
from measure import version_of
from numpy.typing import NDArray
from problem import EDGES, Chain, judged, probabilities

Array = NDArray[np.float64]

WANTED = 1e-3
"""L1 of p(q2) that the allowed step leaves, and that times are derived for."""
RESOLVED = 3.0
"""Standard errors from which a bias is told from zero."""
BURN_IN, BETWEEN = 40.0, 0.4
"""Time before the first sample (the energy's rate is (c1 + c2)/2 = 0.3: e^-12 is left of the
start), and time between samples."""
REPEATS, LEAST = 7, 0.03
"""Timed repeats, of so many seconds each at least."""
JUDGED = 32
"""Paths below which there is no standard error to judge a bias by: they are timed only."""
LOST = 1e3
"""Size of a state from which a path counts as lost; the energy there is 1e6 kT and more."""


@dataclass(frozen=True)
class Setting:
    """One scheme at one step: ``order`` is its weak order, in theory, for this additive noise.

    ``seconds`` of processor time are sampled for the bias.
    """

    scheme: str
    step: float
    order: int
    paths: int
    seconds: float = 3.0
    note: str = ""


class Walk(Protocol):
    """Trajectories of one setting that have begun."""

    def advance(self, steps: int) -> None:
        """Make so many steps, and return when they are made."""

    def states(self) -> Array:
        """Return the states (4, paths): q1, q2, p1, p2."""


Line = dict
Maker = Callable[[Setting, Chain, Array, int], Walk]
"""From a setting, the system, states (4, paths) to start from and a seed."""


def measure_all(peer: str, package: str, settings: Sequence[Setting], maker: Maker) -> None:
    """Try the settings that the command line asks for and print the lines."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--smallest", action="store_true", help="the first setting, briefly")
    parser.add_argument("--sampling", type=float, help="A of L1 = A/√(paths × time)")
    arguments = parser.parse_args()
    chosen = [replace(settings[0], seconds=0.2)] if arguments.smallest else settings
    about = {"peer": peer, "version": version_of(package)}
    for setting in chosen:
        print(json.dumps(about | tried(setting, maker, arguments.sampling)), flush=True)


def tried(setting: Setting, maker: Maker, sampling: float | None) -> dict:
    """Return the line of one setting; what a package raises is a finding and goes into the note."""
    try:
        walk, first = begun(setting, maker, judged())
        advanced(walk, round(BURN_IN / setting.step), stride(setting))
        ns = nanoseconds(walk, setting)
        counts = sampled(walk, setting)
        gone = share_lost(walk)
    except Exception as error:  # whatever a package raises is what this run found out
        words = f"fails: {type(error).__name__}: {' '.join(str(error).split())}"[:160]
        return described(setting, None, None, {}, {}, words)
    judge = not gone and setting.paths >= JUDGED
    found = density_bias(counts) if judge else {}
    return described(setting, ns, sampling, {"first": first, "lost": gone}, found, "")


def described(
    setting: Setting, ns: float | None, sampling: float | None, about: dict, found: dict, words: str
) -> dict:
    """Return the line of kind ``scheme``; keys that were not found are None."""
    line: dict = {"kind": "scheme", "scheme": setting.scheme, "step": setting.step}
    line |= {"order": setting.order, "paths": setting.paths, "ns": ns}
    line |= dict.fromkeys(("first", "lost", "L1", "L1_error")) | about | found
    allowed = allowed_step(setting, line["L1"], line["L1_error"])
    ns_time = ns / allowed if ns and allowed else None
    seconds = 1e-9 * ns_time * (sampling / WANTED) ** 2 if ns_time and sampling else None
    line |= {"allowed": allowed, "ns_time": ns_time, "seconds": seconds}
    return line | {"note": "; ".join(filter(None, [setting.note, words]))}


def allowed_step(setting: Setting, bias: float | None, error: float | None) -> float | None:
    """Return the step of bias ``WANTED`` by the weak order, from the bias at a step above it.

    A bias below ``WANTED`` at the step leaves that step: nothing is extrapolated upward. None where
    the bias cannot be told from zero and may be larger than ``WANTED``, or was not found.
    """
    if bias is None or error is None:
        return None
    if abs(bias) + 2.0 * error <= WANTED:
        return setting.step
    if abs(bias) < RESOLVED * error:
        return None
    return setting.step * min(1.0, WANTED / abs(bias)) ** (1.0 / setting.order)


def begun(setting: Setting, maker: Maker, chain: Chain) -> tuple[Walk, float]:
    """Return a walk and the seconds of its first steps, compilation in them."""
    start = process_time()
    walk = maker(setting, chain, chain.start(setting.paths, 17), 23)
    walk.advance(stride(setting))
    return walk, process_time() - start


def stride(setting: Setting) -> int:
    """Return the steps between two samples."""
    return max(1, round(BETWEEN / setting.step))


def sampled(walk: Walk, setting: Setting) -> Array:
    """Return counts (2, bins) of q2 in each half of the paths."""
    counts, end = np.zeros((2, EDGES.size)), process_time() + setting.seconds
    while process_time() < end:
        walk.advance(stride(setting))
        counts += counted(walk.states()[1])
    return counts


def counted(q: Array) -> Array:
    """Return counts (2, bins) of two halves of q2 (paths,); the last bin is beyond ``EDGES``."""
    bins, half = EDGES.size - 1, q.size // 2
    inside = (q >= EDGES[0]) & (q < EDGES[-1])
    share = (np.where(inside, q, EDGES[0]) - EDGES[0]) / (EDGES[-1] - EDGES[0])
    where = np.where(inside, np.minimum((bins * share).astype(int), bins - 1), bins)
    halves = (where[:half], where[half:])
    return np.array([np.bincount(w, minlength=bins + 1) for w in halves], dtype=float)


def density_bias(counts: Array) -> dict[str, float]:
    """Return L1 and L1_error of p(q2) from the counts (2, bins) of two independent halves.

    Half their difference has the noise of their mean and no bias: its L1 is taken off in quadrature
    (exact for Gaussian noise where bias and noise are of one shape over the bins). Half of it is
    the error: the L1 of noise of 65 correlated bins scatters by less. A bias of 0 means that it
    does not show in the noise.
    """
    halves = counts / counts.sum(axis=1, keepdims=True)
    whole = np.abs(halves.mean(axis=0) - probabilities()).sum()
    noise = 0.5 * np.abs(halves[0] - halves[1]).sum()
    return {"L1": float(np.sqrt(max(whole**2 - noise**2, 0.0))), "L1_error": float(0.5 * noise)}


def advanced(walk: Walk, steps: int, every: int) -> None:
    """Make at least ``steps`` steps, ``every`` at a time: what is compiled is for that number."""
    for _ in range(-(-steps // every)):
        walk.advance(every)


def nanoseconds(walk: Walk, setting: Setting) -> float:
    """Return the median processor time per particle-step, nothing observed."""
    steps = stride(setting)
    while timed(walk, steps) < LEAST:
        steps *= 2
    times = [timed(walk, steps) for _ in range(REPEATS)]
    return 1e9 * median(times) / (steps * setting.paths)


def timed(walk: Walk, steps: int) -> float:
    """Return the processor time of so many steps."""
    start = process_time()
    walk.advance(steps)
    return process_time() - start


def share_lost(walk: Walk) -> float:
    """Return the share of paths that are not finite or far out."""
    with np.errstate(invalid="ignore"):
        return float(np.mean(~(np.abs(walk.states()) < LOST).all(axis=0)))


def telling(lines: Sequence[Line]) -> list[Line]:
    """Return the lines of kind ``scheme`` whose time to the wanted error may be taken.

    Of a scheme that was run at several steps above the allowed one only the finest is taken, from
    which the order is trusted least far; a step whose own bias is small enough always.
    """
    found: list[Line] = []
    with_step = [s for s in lines if s["kind"] == "scheme" and s["allowed"] is not None]
    for peer, scheme in dict.fromkeys((s["peer"], s["scheme"]) for s in with_step):
        same = [s for s in with_step if (s["peer"], s["scheme"]) == (peer, scheme)]
        found += [s for s in same if s["allowed"] == s["step"]]
        found += sorted((s for s in same if s["allowed"] < s["step"]), key=lambda s: s["step"])[:1]
    return found


def best(lines: Sequence[Line], peers: Sequence[str]) -> Line | None:
    """Return the scheme of ``peers`` with the least ns per path and unit time."""
    fit = [s for s in telling(lines) if s["peer"] in peers]
    return min(fit, key=lambda line: line["ns_time"], default=None)
