"""Run every hard case and write docs/hard-cases.md: python tests/hard/page.py (ten minutes)."""

import sys
from importlib import import_module
from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "docs" / "hard-cases.md"
HEAD = ("case", "what makes it hard", "plain method", "this program", "certificate", "checks")
INTRODUCTION = """\
# Hard cases

Written by `tests/hard/page.py`; the same cases are tests.

Plain methods were run, not guessed: for densities of the energy P2 elements on 1000 equal cells \
up to 20 energy scales, for motions Euler-Maruyama in NumPy. L1 is the distance to the closed \
form. Every scene is held to, by finite elements and by quadrature: certified, mass one to 1e-12 \
and the stated error, minimum above -1e-14 of the maximum, true error within the \
stated one (and 1e-12). With one contact mass at the most also: the error at least halved by every \
bisection down to round-off and what is stated, the same in other units to 1e-10 and what is \
stated. Where a displacement is observed: the mirror image to 1e-13.
"""


def page_text(cases):
    """Return the page: one row a case."""
    lines = [INTRODUCTION, "| " + " | ".join(HEAD) + " |", "|" + " --- |" * len(HEAD)]
    for c in cases:
        holding = f"{len(c.checks) - len(c.failures)} of {len(c.checks)} hold"
        cells = (c.name, c.hard, c.plain, c.ours, c.certificate, holding)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join([*lines, ""])


def main():
    """Run the cases one after the other, print what fails, write the page."""
    cases = []
    sys.path.append(str(Path(__file__).parents[1]))  # systems of all tests
    for module in ("hard_scenes", "hard_meshes", "hard_simulations"):
        for make in import_module(module).CASES:
            cases.append(make())
            print(cases[-1].name, *(cases[-1].failures or ["holds"]), sep="\n  ")
    PAGE.write_text(page_text(cases), encoding="utf-8")


if __name__ == "__main__":
    main()
