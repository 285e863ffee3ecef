"""Run ``fpk cost`` on two scenes and join their pages: docs/cost/cost.md and the diagrams.

    python benchmarks/cost_page.py

Takes one to two minutes a scene.
"""

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from report import machine

DOCS = Path(__file__).resolve().parent.parent / "docs" / "cost"
SCENES = ("fig6b", "fig8b")
INTRODUCTION = """# What accuracy costs

Written by `benchmarks/cost_page.py`: the pages of `fpk cost`. {}.

Of each equation, what an L1 error costs by each route: (24) is the averaged energy, (17) the modal
energies, (6) the full system. `exact_flow`, `baoab` and `euler_maruyama` are schemes of the
simulation; (dt, N): step and number of paths are those of least cost, the error that of sampling
and step.
"""


def main() -> None:
    """Write the page; stop where a study fails."""
    parts = [INTRODUCTION.format(machine())]
    command = "from cases.command.cli import main; main()"
    for scene in SCENES:
        with TemporaryDirectory() as folder:
            arguments = [sys.executable, "-c", command, "cost", scene, "--out", folder]
            subprocess.run(arguments, check=True)
            page = (Path(folder) / "cost.md").read_text()
            (DOCS / f"{scene}.svg").write_text((Path(folder) / "cost.svg").read_text())
        title, *lines = page.splitlines()
        lines = [title, "", f"![Error against time, {scene}]({scene}.svg)", *lines]
        parts.append("\n".join(f"#{x}" if x.startswith("#") else x for x in lines) + "\n")
    (DOCS / "cost.md").write_text("\n".join(parts))


if __name__ == "__main__":
    main()
