"""Rare failure of an averaged energy by splitting, beside pyTAMS where it is installed."""

import json
import subprocess
import sys
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from averaged_splitting import rare_failure_of_process
from scipy.optimize import brentq

from averaging.energy_process import energy_process
from averaging.nonintegrable import square_root
from fpk.system.system import System
from sim.questions.splitting import Splitting

TIME, STEP, REPLICAS, RUNS = 100.0, 0.3125, 32, 4
COLUMNS = ["by", "replicas", "runs", "P", "stated error", "spread", "steps", "seconds"]


def rare(system: System, c: float, D: float) -> list[list[str]]:
    """Return the rows of rare failure of the averaged energy dH = (D − cH) dt + √(2DH) dB."""
    closed, table = square_root(system, "closed-form"), []
    now = partial(closed.passage, start=0.0, times=np.array([TIME]), tol=1e-10)
    limit = float(brentq(lambda H: now(H).failure[0] - 1e-6, 8.0, 11.0, xtol=1e-13))
    few = {"replicas": REPLICAS, "killed": 1, "repetitions": 8}
    for name, chosen in (("warm-up", few), ("default", {}), ("one killed", few)):
        s = Splitting(dt=2.0 * STEP, threads=1, **chosen)
        r = rare_failure_of_process(energy_process(system), limit, TIME, settings=s)
        about = [f"vibro-fpk, {name}", str(s.replicas), f"2 x {s.repetitions}"]
        numbers = [f"{r.probability:.2e}", f"{r.error:.0e}", f"{r.sampling_error:.0e}"]
        table.append([*about, *numbers, f"{r.steps:.1e}", f"{r.seconds:.2f}"])
    model = {"c": c, "D": D, "time": TIME, "limit": limit}
    script = str(Path(__file__).resolve().with_name("passage_tams.py"))
    about = ["pyTAMS", str(REPLICAS)]
    if find_spec("pytams") is None:
        return [*table[1:], [*about, "not installed", *["–"] * 5]]
    given = {"replicas": REPLICAS, "step": STEP, "model": model}
    command = [sys.executable, script, json.dumps(given)]
    # In a process of its own, as it forks: this one may have threads.
    out = [
        subprocess.run(command, capture_output=True, check=True, timeout=600).stdout
        for _ in range(RUNS)
    ]
    P, steps, seconds = np.array([json.loads(line) for line in out]).T
    numbers = [f"{P.mean():.2e}", "–", f"{P.std(ddof=1) / RUNS**0.5:.0e}"]
    last = [*about, str(RUNS), *numbers, f"{steps.sum():.1e}", f"{seconds.sum():.0f}"]
    return [*table[1:], last]
