"""All hard cases, one after the other, and what is told of them."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

from cases.stability.case import Group, HardCase
from cases.stability.lines import line_cases
from cases.stability.motion import motion_cases
from cases.stability.scenes import scene_cases
from cases.summary import plain
from fpk.method import Progress, silent

GROUPS: tuple[Group, ...] = (scene_cases, line_cases, motion_cases)


def hard_cases(progress: Progress = silent) -> Iterator[HardCase]:
    """Run every hard case."""
    for group in GROUPS:
        yield from group(progress)


def hard_line(case: HardCase) -> str:
    """Return the line of one case, printed as soon as it is done."""
    verdict = "holds" if not case.failures else f"{len(case.failures)} FAIL"
    return f"{case.name:34}  {verdict:8} {len(case.checks):3} checks, {case.seconds:5.1f} s"


def hard_record(cases: Sequence[HardCase]) -> dict[str, Any]:
    """Return the record of ``fpk verify --hard``."""
    record: dict[str, Any] = plain(
        {
            "cases": [{**asdict(c), "failures": c.failures} for c in cases],
            "holds": not any(c.failures for c in cases),
            "seconds": sum(c.seconds for c in cases),
        }
    )
    return record


def hard_table(cases: Sequence[HardCase]) -> str:
    """Return the page ``docs/hard-cases.md``."""
    head = ("case", "what makes it hard", "plain method", "this program", "certificate", "checks")
    lines = [
        "# Hard cases",
        "",
        "Written by `fpk verify --hard --out docs/hard-cases.md`.",
        "",
        "Plain methods were run, not guessed: for densities of the energy P2 elements on 1000 equal"
        " cells up to 20 energy scales, for motions Euler-Maruyama in NumPy. L1 is the distance to"
        " the closed form. Every scene is held to, by finite elements and by quadrature: certified,"
        " mass one to 1e-12 and a thousandth of the stated error, minimum above -1e-14 of the"
        " maximum, true error within the stated one (and 1e-12). With one contact mass at the most"
        " also: the error at least halved by every bisection down to round-off and what is stated,"
        " the same in other units to 1e-10 and what is stated. Where a displacement is observed:"
        " the mirror image to 1e-13.",
        "",
        "| " + " | ".join(head) + " |",
        "|" + " --- |" * len(head),
    ]
    for c in cases:
        held = f"{len(c.checks) - len(c.failures)} of {len(c.checks)} hold"
        cells = (c.name, c.hard, c.plain, c.ours, c.certificate, held)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join([*lines, ""])
