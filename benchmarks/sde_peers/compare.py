"""Run the packages for SDEs that are installed, name those missing, and write the page.

    python benchmarks/sde_peers/compare.py [--out docs/benchmarks/sde-peers.md] [--python PATH]
        [--only NAME] [--smallest] [--json FILE]

As ``peers/run.py``. This program comes first: its constant A turns the others' steps into times.
Ends with 0 whoever is missing, with 1 where this program was asked for and its own lines are.
"""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parent / "peers")]

from run import compare  # noqa: E402
from sde_page import OURS, SCRIPTS, written  # noqa: E402


def constant(lines: list[dict]) -> list[str]:
    """Return the argument that has A, if it has been measured."""
    found = [line["A"] for line in lines if line["kind"] == "sampling"]
    return ["--sampling", repr(found[0])] if found else []


if __name__ == "__main__":
    stopped = compare(HERE, SCRIPTS, written, "sde-peers.md", constant)
    sys.exit(1 if OURS in stopped else 0)
