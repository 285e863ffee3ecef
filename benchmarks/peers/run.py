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
from collections.abc import Callable, Mapping
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from measure import MISSING  # noqa: E402

LIMIT = 120.0
"""Seconds a script may take."""
THREADS = ("OMP", "OPENBLAS", "MKL", "NUMBA", "NUMEXPR")


def results(python: str, script: Path, arguments: list[str]) -> tuple[list[dict], str]:
    """Return the measurements of a script, and what stopped it short, empty if nothing did."""
    environment = os.environ | {f"{library}_NUM_THREADS": "1" for library in THREADS}
    command, reason = [python, str(script), *arguments], ""
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=LIMIT, check=False
        )
    except subprocess.TimeoutExpired as late:
        printed, reason = late.stdout or b"", f"stopped after {LIMIT:g} s"
        text = printed.decode() if isinstance(printed, bytes) else printed
    else:
        text = done.stdout
        if done.returncode == MISSING:
            return [], "not installed"
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            reason = f"ended with status {done.returncode}: {last}"
    # Whole JSON lines: libraries print words of their own in between.
    lines = [json.loads(line) for line in text.split("\n")[:-1] if line.startswith('{"peer"')]
    return lines, reason


def compare(
    folder: Path,
    scripts: Mapping[str, str],
    written: Callable[[list[dict], dict[str, str]], str],
    page: str,
    given: Callable[[list[dict]], list[str]] = lambda lines: [],
) -> dict[str, str]:
    """Run ``scripts`` of a ``folder`` and write their ``page``; return who was stopped, and why.

    ``given``: arguments of the next script by the lines so far.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks") / page)
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--only", choices=scripts, action="append", help="these peers only")
    parser.add_argument("--smallest", action="store_true", help="the smallest setting of each")
    parser.add_argument("--json", type=Path, help="keep the measurements here, one a line")
    arguments = parser.parse_args()
    lines, stopped = list[dict](), dict[str, str]()
    for peer in arguments.only or scripts:
        more = ["--smallest"] * arguments.smallest + given(lines)
        found, reason = results(arguments.python, folder / scripts[peer], more)
        lines += found
        if reason:
            stopped[peer] = reason
        print(f"{peer}: {len(found)} lines{', ' + reason if reason else ''}", flush=True)
    if arguments.json:
        arguments.json.write_text("".join(json.dumps(line) + "\n" for line in lines))
    arguments.out.write_text(written(lines, stopped))
    return stopped


if __name__ == "__main__":
    from page import SCRIPTS, written

    compare(HERE, SCRIPTS, written, "peers.md")
