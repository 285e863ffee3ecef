"""Run the packages for SDEs that are installed, name those missing, and write the page.

    python benchmarks/sde_peers/compare.py [--out docs/benchmarks/sde-peers.md] [--python PATH]
        [--only NAME] [--smallest] [--json FILE]

Each script runs alone in a process of its own, on one core, with a time limit. This program comes
first: its constant A turns the others' steps into times. ``--python`` is the interpreter that the
packages, and this program, are installed for. Ends with 0 whoever is missing, with 1 where this
program was asked for and its own lines are.
"""

import argparse
import json
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parent / "peers")]

from run import results  # noqa: E402
from sde_page import OURS, SCRIPTS, written  # noqa: E402


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/sde-peers.md"))
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--only", choices=SCRIPTS, action="append", help="these packages only")
    parser.add_argument("--smallest", action="store_true", help="the first setting of each")
    parser.add_argument("--json", type=Path, help="keep the measurements here, one a line")
    arguments = parser.parse_args()
    extra = ["--smallest"] if arguments.smallest else []
    lines: list[dict] = []
    stopped: dict[str, str] = {}
    for peer in arguments.only or SCRIPTS:
        constant = [line["A"] for line in lines if line["kind"] == "sampling"]
        given = ["--sampling", repr(constant[0])] if constant else []
        script = str(HERE / SCRIPTS[peer])
        found, reason = results(arguments.python, script, extra + given)
        lines += found
        if reason:
            stopped[peer] = reason
        print(f"{peer}: {len(found)} lines{', ' + reason if reason else ''}", flush=True)
    if arguments.json:
        arguments.json.write_text("".join(json.dumps(line) + "\n" for line in lines))
    arguments.out.write_text(written(lines, stopped))
    sys.exit(1 if OURS in stopped else 0)


if __name__ == "__main__":
    main()
