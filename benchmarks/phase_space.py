"""The full equation without sampling: time and stated error, beside the time sampling would need.

    python benchmarks/phase_space.py [--out docs/benchmarks/phase_space.md]

Both cores, wall time of one answer. The time of sampling follows from a run of ten seconds: its
error falls with the root of the time that is sampled, which is long against the relaxation time
then; the time before it, in which the start is forgotten, is the same for any error.
"""

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

from itertools import product
from time import perf_counter

from report import markdown_table, medians, write_page

from averaging.phase_space.method import PhaseSpace
from averaging.phase_space.refinement import SOLUTION_MEMORY
from averaging.theory import Exact
from cases.compare.compare import chance_l1, join_bins
from fpk.answer.density import Density, l1_distance
from fpk.answer.names import parse_observable
from fpk.answer.sampled_density import SampledDensity
from fpk.system.contact import Contact
from fpk.system.system import System
from sim.montecarlo import MonteCarlo

TOL = 1e-4
SECONDS = 10.0
REPEATED = 7
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
    simulation = MonteCarlo(seconds=SECONDS, tol=1e-9, seed=1).solve(system, Q2)
    spent, (sampled,) = perf_counter() - start, simulation.densities
    assert isinstance(sampled, SampledDensity)
    before, time = (float(simulation.settings[key]) for key in ("burn_in", "time"))
    more = (chance_l1(join_bins(sampled))[0] / density.l1_error) ** 2
    needed = spent * (before + time * more) / (before + time)
    certified = "yes" if density.certificate.certified else "no"
    degrees = f"{result.settings['highest degree']}"
    print(*words, f"{seconds:.1f} s", f"{density.l1_error:.1e}", flush=True)
    times = [f"{seconds:.1f} s", f"{needed:.2g} s"]
    return [*words, degrees, f"{density.l1_error:.1e}", certified, *times]


def one_mass() -> list[str]:
    """Return what a stated error of 1e-10 costs with one mass, where the density is exact."""
    system = System([1], [1], [0.04], [0.02], contacts=(Contact(1, "both", 10.0, 0.5),))
    q1, tol = (parse_observable("q1", 1),), 1e-10
    seconds = medians(lambda: PhaseSpace(tol=tol).solve(system, q1), repeats=REPEATED)
    result = PhaseSpace(tol=tol).solve(system, q1)
    (density,), (exact,) = result.densities, Exact().solve(system, q1).densities
    assert isinstance(density, Density) and isinstance(exact, Density)
    true, time = l1_distance(density, exact), f"{1e3 * seconds:.0f} ms"
    degree, stated = f"{result.settings['highest degree']}", f"{density.l1_error:.1e}"
    return [f"{tol:.0e}", degree, stated, f"{true:.1e}", time]


def three_masses() -> list[list[str]]:
    """Return the stated error of p(q2) of three masses for more and more memory."""
    damping, noise = [0.08, 0.06, 0.04], [0.01, 0.015, 0.02]
    stop = Contact(2, "both", 10.0, 0.5)
    system = System([1, 1, 1], [1, 1, 1], damping, noise, contacts=(stop,))
    rows = []
    for memory in (0.4, 1.0, SOLUTION_MEMORY, 16.0):
        start = perf_counter()
        result = PhaseSpace(tol=1e-8, accepted=1.0, memory=memory).solve(
            system, (parse_observable("q2", 3),)
        )
        seconds, (density,) = perf_counter() - start, result.densities
        assert isinstance(density, Density)
        degree = f"{result.settings['highest degree']}"
        rows.append([f"{memory:g} GB", degree, f"{density.l1_error:.1e}", f"{seconds:.0f} s"])
        print(*rows[-1], flush=True)
    return rows


WORDS = (
    "p(q2) of Fig. 6(a) with other stops; wall time on both cores, all coarser solutions included;"
    " sampling: the time that a simulation would need for the same L1 error, from one of"
    f" {SECONDS:g} s."
)


def body() -> str:
    """Return the tables."""
    cases = [(10.0, 0.5, "both", 1.0, tol) for tol in (1e-3, 1e-4)]
    cases += [(B, gap, "both", 1.0, TOL) for B, gap in product(STIFFNESS, CLEARANCE)]
    cases += [(B, 0.5, "right", 1.0, TOL) for B in STIFFNESS]
    cases += [(10.0, 0.5, "both", 10.0, TOL)]
    cases += [(10.0, 0.5, "both", 1.0, tol) for tol in (1e-5, 1e-6)]
    rows = []
    for B, clearance, side, lighter, tol in cases:
        damping = "c" if lighter == 1.0 else f"c/{lighter:g}"
        words = [f"{B:g}", f"{clearance:g}", side, damping, f"{tol:.0e}"]
        rows.append(row(fig6(B, clearance, side, lighter), tol, words))
    head = ["B", "clearance", "sides", "damping", "tol", "degree", "stated L1", "certified", "time"]
    one = markdown_table(["tol", "degree", "stated L1", "true L1", "time"], [one_mass()])
    three = markdown_table(["memory", "degree", "stated L1", "time"], three_masses())
    return (
        markdown_table([*head, "sampling"], rows)
        + "\n## One mass\n\nStops on both sides, B = 10, δ = 0.5; c = 0.04, D = 0.02; p(q1), median"
        f" of {REPEATED}.\n\n{one}\n## Three masses\n\nStops on both sides of the second, B = 10,"
        " δ = 0.5, c = (0.08, 0.06, 0.04), D = (0.01, 0.015, 0.02); p(q2), by the memory that a"
        f" solution may need, and work in proportion to its power 3/2.\n\n{three}"
    )


if __name__ == "__main__":
    title = "The full equation without sampling"
    write_page(title, "phase_space.py", WORDS, body, "docs/benchmarks/phase_space.md")
