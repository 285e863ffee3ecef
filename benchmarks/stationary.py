"""Measure what the stationary 1-D solution costs: finite elements, quadrature, coefficients.

    python benchmarks/stationary.py [--out docs/benchmarks/stationary.md]

One thread, warm-up, medians of repeats, coefficients included in every solve. Answers are checked
against (29) before they are timed; the error is the L1 distance, integrated on finer panels.
"""

import argparse
import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import statistics
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from report import machine, markdown_table

from averaging.energy_process import closed_form_density, energy_process
from averaging.zero_flux import solve_by_quadrature
from cases.scene.scene import load_scene
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.stationary import solve_stationary
from fpk.system.system import System

Array = NDArray[np.float64]
REPEATS = 41


def scenes() -> dict[str, System]:
    """Return the curves of Fig. 6(a)-(c), and its base system with stiffer contacts."""
    found = {}
    for name in ("fig6a", "fig6b", "fig6c"):
        for curve in load_scene(name).curves:
            found[f"{name}, {curve.label}" if curve.label else name] = curve.system
    base = load_scene("fig6a").system
    for stiffness in (1e2, 1e4, 1e6):
        stops = tuple(replace(stop, stiffness=stiffness) for stop in base.contacts)
        found[f"fig6a, B = {stiffness:g}"] = replace_contacts(base, stops)
    return found


def replace_contacts(system: System, contacts: tuple) -> System:
    """Return the system with other contacts."""
    return System(
        system.mass,
        system.stiffness,
        system.damping,
        system.noise_intensity,
        system.noise_gain,
        contacts,
    )


def median_ms(work: Callable[[], object]) -> float:
    """Return the median wall time of ``work`` in milliseconds after a warm-up."""
    work()
    times = []
    for _ in range(REPEATS):
        start = perf_counter()
        work()
        times.append(perf_counter() - start)
    return 1e3 * statistics.median(times)


def l1_error(density: Callable[[Array], Array], system: System, nodes: Array) -> float:
    """Return ∫|p − p_(29)| over the panels of both."""
    reference = closed_form_density(system)
    x, w = panel_rule(np.unique(np.concatenate([nodes, reference.nodes])), 24)
    return float(np.sum(w * np.abs(density(x) - reference.density(x))))


def rows(tol: float) -> list[list[str]]:
    """Return the table, one row per scene and solver."""
    table = []
    for name, system in scenes().items():
        for solver in ("fem", "quadrature (11)"):
            if solver == "fem":
                work = partial(_elements, system, tol)
                found = work()
                density, unknowns = found.density, found.unknowns
            else:
                work = partial(_quadrature, system, tol)
                found = work()
                density = partial(_exp_log, found)
                unknowns = found.nodes.size - 1
            error = l1_error(density, system, found.nodes)
            if error > 100 * tol:
                table.append([name, solver, "wrong, not timed", "", f"{error:.1e}", ""])
                continue
            table.append(
                [
                    name,
                    solver,
                    f"{median_ms(work):.2f}",
                    str(unknowns),
                    f"{error:.1e}",
                    f"{found.l1_error:.1e}",
                ]
            )
        energy = np.linspace(1e-3, 8.0, 350) * energy_process(system).energy_scale
        process = energy_process(system)
        cost = median_ms(partial(process.coefficients, energy))
        table.append([name, "coefficients at 350 energies", f"{cost:.2f}", "350", "", ""])
    return table


def _elements(system: System, tol: float):
    return solve_stationary(energy_process(system), tol=tol)


def _quadrature(system: System, tol: float):
    return solve_by_quadrature(energy_process(system), tol=tol)


def _exp_log(solution, energy: Array) -> Array:
    return np.exp(solution.log_density(energy))


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/stationary.md"))
    parser.add_argument("--tol", type=float, default=1e-10)
    arguments = parser.parse_args()
    header = ["scene", "solver", "median ms", "unknowns or panels", "L1 error", "its estimate"]
    arguments.out.write_text(
        "# Stationary density of the averaged energy process\n\n"
        f"Written by `benchmarks/stationary.py`, tolerance {arguments.tol:g}, one thread, medians"
        f" of {REPEATS} solves after a warm-up, coefficients included. {machine()}.\n\n"
        "The error is ∫|p − p₍₂₉₎| dH against the closed form of the same equation.\n\n"
        + markdown_table(header, rows(arguments.tol))
    )
    print(arguments.out.read_text())


if __name__ == "__main__":
    main()
