"""The full equation without sampling: time and stated error, beside the time sampling would need.

    python benchmarks/phase_space.py [--out docs/benchmarks/phase_space.md]

Both cores, wall time of one answer. The time of sampling follows from a run of two seconds, as its
error falls with the root of the time.
"""

import argparse
import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

from itertools import product
from pathlib import Path
from time import perf_counter

from report import machine, markdown_table

from averaging.phase_space.method import PhaseSpace
from cases.comparison.compare import chance_l1, joined
from fpk.contact import Contact
from fpk.density import Density
from fpk.observable import parse_observable
from fpk.sampled_density import SampledDensity
from fpk.system import System
from sim.montecarlo import MonteCarlo

TOL = 1e-4
SECONDS = 2.0
STIFFNESS, CLEARANCE = (0.1, 1.0, 10.0, 100.0), (0.1, 0.5, 1.5)
Q2 = (parse_observable("q2", 2),)


def fig6(B: float, clearance: float, side: str, lighter: float = 1.0) -> System:
    """Return the system of Fig. 6(a) with other stops, damping and noise divided by ``lighter``."""
    stop = Contact(2, side, B, clearance)  # type: ignore[arg-type]
    damping, noise = [0.08 / lighter, 0.04 / lighter], [0.01 / lighter, 0.02 / lighter]
    return System([1, 1], [1, 1], damping, noise, contacts=(stop,))


def row(system: System, tol: float, words: list[str]) -> list[str]:
    """Return time and stated error of p(q2), and the time of a simulation with that error."""
    start = perf_counter()
    result = PhaseSpace(tol=tol).solve(system, Q2)
    seconds, (density,) = perf_counter() - start, result.densities
    assert isinstance(density, Density)
    start = perf_counter()
    (sampled,) = MonteCarlo(seconds=SECONDS, tol=1e-9, seed=1).solve(system, Q2).densities
    spent = perf_counter() - start
    assert isinstance(sampled, SampledDensity)
    needed = spent * (chance_l1(joined(sampled))[0] / density.l1_error) ** 2
    certified = "yes" if density.certificate.certified else "no"
    degrees = f"{result.settings['highest degree']}"
    print(*words, f"{seconds:.1f} s", f"{density.l1_error:.1e}", flush=True)
    return [
        *words,
        degrees,
        f"{density.l1_error:.1e}",
        certified,
        f"{seconds:.1f} s",
        f"{needed:.2g} s",
    ]


def main() -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/phase_space.md"))
    out = parser.parse_args().out
    head = ["B", "clearance", "sides", "damping", "tol", "degree", "stated L1", "certified", "time"]
    head.append("sampling")
    rows = []
    for tol in (1e-3, 1e-4):
        words = ["10", "0.5", "both", "c", f"{tol:.0e}"]
        rows.append(row(fig6(10.0, 0.5, "both"), tol, words))
    cases = [("both", B, clearance) for B, clearance in product(STIFFNESS, CLEARANCE)]
    cases += [("right", B, 0.5) for B in STIFFNESS]
    for side, B, clearance in cases:
        words = [f"{B:g}", f"{clearance:g}", side, "c", f"{TOL:.0e}"]
        rows.append(row(fig6(B, clearance, side), TOL, words))
    rows.append(
        row(fig6(10.0, 0.5, "both", 10.0), TOL, ["10", "0.5", "both", "c/10", f"{TOL:.0e}"])
    )
    text = "# The full equation without sampling\n\nWritten by `benchmarks/phase_space.py`. "
    text += machine() + ".\n\np(q2) of Fig. 6(a) with other stops; wall time on both cores, all "
    text += "coarser solutions included; sampling: the time that a simulation would need for the "
    text += f"same L1 error, from one of {SECONDS:g} s.\n\n"
    out.write_text(text + markdown_table(head, rows))


if __name__ == "__main__":
    main()
