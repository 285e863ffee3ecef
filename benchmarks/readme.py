"""Run the commands of the README as a newcomer does, and write output and durations into it.

    python benchmarks/readme.py [--pages | --check]

A fresh copy of the sources gets a fresh environment by the first command of Set-up; then the
commands of the ``console`` blocks are run there in order. Each block gets what its command prints,
of a run the lines that matter, and the seconds that it took. What stands between
``<!-- NAME -->`` and ``<!-- end -->`` is written anew: the line of the machine and the table of
trust, whose figures are those of the pages in docs/. ``--pages`` writes that table alone.
``--check`` changes no document: it runs the commands in the folder that it is called from, where
the first command of Set-up has been run, and fails where a line differs by more than durations.

All run with the linear algebra of one kind of processor, which any x86-64 one with AVX2 has: the
last bits of the matrices of a step are those of its kernels, and another sample of the same law
follows from others.
"""

import argparse
import os
import re
import subprocess
import sys
from collections.abc import Callable
from difflib import unified_diff
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from measured_tables import ROOT, page_blocks
from report import machine, markdown_table

README = ROOT / "README.md"
CONSOLE = re.compile(r"```console\n\$ (.*?)(?: +# [\d.]+ s)?\n(.*?)\n```", re.DOTALL)
KERNELS = {"OPENBLAS_CORETYPE": "Haswell"}
"""Kind of processor that the linear algebra of NumPy and SciPy takes the present one for."""
DURATION = re.compile(r"\b[\d.]+ (s|ms|min)\b")
RUN = "fpk run fig6a"
OWN = "B = 10\n"
"""Head of the curve of the scene's own system, which is shown."""
QUANTITIES = r"B = 10$|  q2  |  rms|  quantile 99|  contact probability, r|  mean force, r"
CONCLUSIONS = "  averaging error of q2"
END = r"\d+ judged|wrote .*report"
"""Lines of a run that are shown: of its table of q2, of what follows the tables, and of its end."""


def timed(command: str, folder: Path) -> tuple[str, float]:
    """Return what a command prints in ``folder`` and its wall time. Raises where it fails."""
    path = f"{folder / '.venv' / 'bin'}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "COLUMNS": "120", "PYTHONPATH": ""} | KERNELS
    start = perf_counter()
    done = subprocess.run(
        command, shell=True, cwd=folder, env=environment, check=True, text=True, stdout=-1
    )
    return done.stdout, perf_counter() - start


def excerpt(command: str, printed: str) -> str:
    """Return the lines of an output that the README shows: of a run those of its own system."""
    if not command.startswith(RUN):
        return printed.strip()
    own = printed[printed.index(OWN) :].partition("\n\nB = ")[0]
    table, _, conclusions = own.partition("\n  H ")
    lines = [x for x in table.splitlines() if re.match(QUANTITIES, x)]
    lines += [x for x in conclusions.splitlines() if re.match(CONCLUSIONS, x)]
    return "\n".join(lines + [x for x in printed.splitlines() if re.match(END, x)])


def copied(folder: Path) -> None:
    """Copy what git has, and what it does not ignore, to ``folder``."""
    listing = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    files = subprocess.run(listing, cwd=ROOT, capture_output=True, check=True).stdout
    subprocess.run(["tar", "--null", "-T", "-", "-cf", folder / "all.tar"], input=files,
                   cwd=ROOT, check=True)  # fmt: skip
    subprocess.run(["tar", "-xf", "all.tar"], cwd=folder, check=True)


def setup_command() -> str:
    """Return the first command of Set-up."""
    script = [sys.executable, str(ROOT / ".ci" / "readme_commands.py")]
    return subprocess.run(script, capture_output=True, text=True, check=True).stdout.split("\n")[0]


def cells(name: str) -> list[list[str]]:
    """Return the rows of a short table of the pages, without its header."""
    rows = [line for line in page_blocks()[name].splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows[2:]]


def trust_table() -> str:
    """Return what speaks for the numbers, with figures from the pages in docs/."""
    hard = (ROOT / "docs" / "hard-cases.md").read_text(encoding="utf-8")
    checks = [(int(a), int(b)) for a, b in re.findall(r"(\d+) of (\d+) hold \|\n", hard)]
    held, all_checks = (sum(column) for column in zip(*checks, strict=True))
    slips = (ROOT / "docs" / "slips.md").read_text(encoding="utf-8").count("\n| (")
    ours, *others = cells("cost")
    fipy = next(row for row in others if row[0] == "FiPy")
    sampled = cells("sde")
    times = sorted(float(row[6]) for row in sampled)
    rows = [
        ["Stated errors are not below the true ones", "random systems against quadrature that "
         "shares no line with the program, `tests/attack`", "in every run of the tests"],
        ["It does not break where others do", "[hard cases](docs/hard-cases.md): stiff stops, "
         "fifty masses, two humps, no noise", f"{len(checks)} cases, {held} of {all_checks} "
         "checks hold"],
        ["Elements solve the averaged equation", "its closed form (29); "
         "[other programs](docs/benchmarks/peers.md)", f"L1 1e-10 in {ours[2]} ms; FiPy "
         f"{fipy[3].replace(' in ', ' at best, in ')} ms"],
        ["The simulation samples the full system", "an exact density; "
         "[other packages](docs/benchmarks/sde-peers.md)", f"L1 0.1 % in {sampled[0][5]} "
         f"s; others take {times[1]:.0f} to {times[-1]:.0f} times as long"],
        ["It is the paper's theory, without its slips", "[derivations](docs/slips.md), and tests "
         "in which printed forms fail", f"{slips} corrections"],
    ]  # fmt: skip
    return markdown_table(["claim", "held against", "figure"], rows)


def between(text: str, name: str, body: str) -> str:
    """Return ``text`` with what stands between the marks of ``name`` replaced."""
    pattern = rf"(<!-- {name} -->\n).*?(<!-- end -->)"
    return re.sub(pattern, lambda m: m[1] + body + m[2], text, flags=re.DOTALL)


def walked(text: str, say: Callable[[str], None]) -> str:
    """Return the README with outputs and durations measured in a fresh environment."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        copied(folder)
        parts = setup_command().replace(".venv/bin/fpk", "fpk").split(" && ")
        durations = []
        for command in parts:
            durations.append(timed(command, folder)[1])
            say(f"{durations[-1]:.3g} s  {command}")

        def measured(block: re.Match[str]) -> str:
            printed, seconds = timed(block[1], folder)
            durations.append(seconds)
            say(f"{seconds:.3g} s  {block[1]}")
            lines = excerpt(block[1], printed)
            return f"```console\n$ {block[1]}  # {seconds:.2g} s\n{lines}\n```"

        text = CONSOLE.sub(measured, text)
    install, first = sum(durations[:-1][: len(parts) - 1]), durations[len(parts) - 1]
    line = (
        f"Measured by `benchmarks/readme.py` on {machine()}: set-up {install:.0f} s, the first run "
        f"of fig6a {first:.0f} s, as the simulation is compiled, and the seconds below: "
        f"{sum(durations):.0f} s from a copy of the source to the report of a scene of one's own.\n"
    )
    return between(text, "machine", line)


def changed(text: str, folder: Path) -> list[str]:
    """Return what the commands of the README print now and it does not say, and the other way."""
    lines = []
    for command, said in CONSOLE.findall(text):
        now = excerpt(command, timed(command, folder)[0])
        old, new = (DURATION.sub("… s", words).splitlines() for words in (said, now))
        lines += unified_diff(old, new, "README.md", command, lineterm="", n=0)
    return lines


def main() -> None:
    """Write the README, or check what it prints."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pages", action="store_true", help="the table of trust alone")
    parser.add_argument("--check", action="store_true", help="say where they print else")
    arguments = parser.parse_args()
    if arguments.check:
        if lines := changed(README.read_text(encoding="utf-8"), Path.cwd()):
            sys.exit("\n".join([*lines, "README.md: write it anew by benchmarks/readme.py"]))
        return
    text = between(README.read_text(encoding="utf-8"), "trust", trust_table())
    README.write_text(text if arguments.pages else walked(text, print), encoding="utf-8")


if __name__ == "__main__":
    main()
