"""Run the peers that are installed, name those that are missing, and write the page.

    python benchmarks/peers/run.py [--out docs/benchmarks/peers.md] [--python PATH] [--only NAME]

Each script runs alone in a process of its own with one thread and a time limit; what it printed
before the limit counts. ``--python`` is the interpreter that the peers are installed for.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from measure import MISSING  # noqa: E402
from page import written  # noqa: E402

SCRIPTS = {
    "vibro-fpk": "ours.py",
    "Chebyshev": "peer_chebyshev.py",
    "Chang-Cooper": "peer_chang_cooper.py",
    "scikit-fem": "peer_scikit_fem.py",
    "NGSolve": "peer_ngsolve.py",
    "FiPy": "peer_fipy.py",
}
LIMIT = 120.0
"""Seconds a script may take."""
THREADS = ("OMP", "OPENBLAS", "MKL", "NUMBA", "NUMEXPR")


def results(python: str, script: str, arguments: list[str]) -> tuple[list[dict], str]:
    """Return the measurements of a script, and what stopped it short, empty if nothing did."""
    environment = os.environ | {f"{library}_NUM_THREADS": "1" for library in THREADS}
    command = [python, str(HERE / script), *arguments]
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=LIMIT, check=False
        )
    except subprocess.TimeoutExpired as late:
        printed = late.stdout or b""
        text = printed.decode() if isinstance(printed, bytes) else printed
        return _lines(text), f"stopped after {LIMIT:g} s"
    if done.returncode == MISSING:
        return [], "not installed"
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        return _lines(done.stdout), f"ended with status {done.returncode}: {last}"
    return _lines(done.stdout), ""


def _lines(text: str) -> list[dict]:
    """Return the whole JSON lines of ``text``; libraries print words of their own in between."""
    return [json.loads(line) for line in text.split("\n")[:-1] if line.startswith('{"peer"')]


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/peers.md"))
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--only", choices=SCRIPTS, action="append", help="these peers only")
    parser.add_argument("--smallest", action="store_true", help="the smallest setting of each")
    parser.add_argument("--json", type=Path, help="keep the measurements here, one a line")
    arguments = parser.parse_args()
    extra = ["--smallest"] if arguments.smallest else []
    lines, stopped = [], {}
    for peer, script in SCRIPTS.items():
        if arguments.only and peer not in arguments.only:
            continue
        found, reason = results(arguments.python, script, extra)
        lines += found
        if reason:
            stopped[peer] = reason
        print(f"{peer}: {len(found)} measurements{', ' + reason if reason else ''}", flush=True)
    if arguments.json:
        arguments.json.write_text("".join(json.dumps(line) + "\n" for line in lines))
    arguments.out.write_text(written(lines, stopped))


if __name__ == "__main__":
    main()
