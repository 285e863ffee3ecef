"""Hard cases of one energy that are no scenes: the rigid stop, meshes, degrees, wrong ends."""

from dataclasses import replace

import numpy as np
from hard_battery import TOL, energy_density
from hard_case import Check, HardCase
from numpy.typing import NDArray
from scipy.integrate import quad

from averaging.energy_process import energy_process
from cases.scene.scene import load_scene
from fpk.answer.density import Density
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.stationary import StationarySolution, solve_on_mesh, solve_stationary
from fpk.system.process import Process
from fpk.system.system import System

Array = NDArray[np.float64]

STIFFNESSES = 10.0 ** np.arange(2, 13, 2)
ORDER = 0.4
"""A stop of stiffness B is entered by (5 H/(2 B))^(2/5): so fast do the coefficients become those
of the rigid one."""
ENERGIES = np.array([0.2, 0.5, 2.0])
"""Above the contact energy 0.125/2 of the scene, in which ½ k_eff q² is a quarter of q²."""
MOST_CELLS = 1_000_000
MOST_PANELS = 20_000


def rigid_coefficients(system: System, energy: float) -> tuple[float, float]:
    """Return drift and diffusion at one energy with rigid stops at ±δ, by quadrature of (27).

    Two masses, the contact on one: with the other integrated out T and Φ are integrals of
    (H − ½ k_eff q²) to the powers ½ and 3/2 over |q| <= δ, and τ = Φ/T their ratio over 3/2.
    """
    (stop, _) = system.stops
    stiffness = 1.0 / np.linalg.inv(system.stiffness_matrix)[stop.index, stop.index]
    end = min(stop.clearance, float(np.sqrt(2.0 * energy / stiffness)))

    def integral(power: float) -> float:
        def integrand(q: float) -> float:
            return float((energy - 0.5 * stiffness * q * q) ** power)

        return float(quad(integrand, 0.0, end, epsrel=1e-13)[0])

    tau = integral(1.5) / integral(0.5) / 1.5
    damping = float(np.sum(np.diag(system.damping) / system.mass))
    noise = float(np.sum(np.diag(system.noise_matrix) / system.mass))
    return noise - damping * tau, 2.0 * noise * tau


def rigid_limit() -> HardCase:
    """The averaged coefficients as B grows, against those of the rigid stop."""
    system = load_scene("stiff-stops").system
    rigid = np.array([rigid_coefficients(system, H) for H in ENERGIES])
    errors = []
    for B in STIFFNESSES:
        stiff = replace(
            system, contacts=tuple(replace(c, stiffness=float(B)) for c in system.contacts)
        )
        c = energy_process(stiff).coefficients(ENERGIES)
        errors.append(np.abs(np.stack([c.drift, c.diffusion], axis=1) / rigid - 1.0).max())
    orders = -np.diff(np.log(errors)) / np.diff(np.log(STIFFNESSES))
    # The next term is smaller by the depth itself, 4e-5 at the last stiffness.
    last = float(orders[-1])
    return HardCase(
        name="rigid limit",
        hard="coefficients of B = 1e2 to 1e12 against those of the rigid stop, computed separately",
        plain="not run",
        ours=f"relative difference {errors[0]:.1e} to {errors[-1]:.1e}",
        certificate="none: coefficients, not a density",
        checks=(
            Check("order 2/5 in 1/B", abs(last - ORDER) < 0.01, f"{last:.4f}"),
            Check("falls with B", bool(np.all(orders > 0.0)), f"orders {np.round(orders, 3)}"),
        ),
    )


def _reference() -> tuple[Process, Density, Array]:
    system = load_scene("fig3b").system
    process = energy_process(system)
    nodes = solve_stationary(process, tol=TOL).nodes
    return process, energy_density(system, "closed-form"), nodes


def true_error(solution: StationarySolution, reference: Density) -> float:
    """L1 distance of a solution to the reference, over its mesh and beyond.

    Of a very fine mesh as many cells are taken together as leave ``MOST_PANELS``.
    """
    nodes = np.unique(np.concatenate([solution.nodes, reference.panels[0]]))
    if nodes.size > MOST_PANELS:
        nodes = np.append(nodes[:: nodes.size // MOST_PANELS], nodes[-1])
    H, w = (x.ravel() for x in panel_rule(nodes[nodes >= 0.0], 8))
    return float(np.sum(w * np.abs(solution.density(H) - reference.pdf(H))))


def _judged(
    name: str,
    hard: str,
    solved: list[tuple[str, StationarySolution]],
    reference: Density,
) -> HardCase:
    """One case from several solutions: each finite, its error no larger than it states."""
    checks, measured = [], []
    for label, solution in solved:
        error = true_error(solution, reference)
        within = error <= solution.l1_error + reference.l1_error
        measured.append(f"{label}: {error:.0e}")
        checks.append(
            Check(
                f"{label}: true error within the stated one",
                bool(np.isfinite(error)) and within,
                f"{error:.1e}, stated {solution.l1_error:.1e}",
            )
        )
    certified = sum(s.certificate.certified for _, s in solved)
    honest = sum(c.holds for c in checks)
    return HardCase(
        name=name,
        hard=hard,
        plain="states no error",
        ours="L1 " + "; ".join(measured),
        certificate=f"{certified} of {len(solved)} certified, {honest} stated errors hold",
        checks=tuple(checks),
    )


def degrees() -> HardCase:
    """Degrees 1 to 12 on one mesh."""
    process, reference, nodes = _reference()
    solved = [(f"p = {p}", solve_on_mesh(process, nodes, p)) for p in range(1, 13)]
    hard = "degrees from 1 to 12 on the same cells: condition, round-off, the estimate at its floor"
    return _judged("degrees", hard, solved, reference)


def meshes() -> HardCase:
    """Equal cells, from two to a million."""
    process, reference, nodes = _reference()
    counts = (2, 20, 2000, MOST_CELLS)
    solved = [
        (f"{n} cells", solve_on_mesh(process, np.linspace(0.0, nodes[-1], n + 1), 2))
        for n in counts
    ]
    hard = "P2 on equal cells, 2 to 1e6: nothing is resolved, or every cell is near round-off"
    return _judged("meshes", hard, solved, reference)


def gradings() -> HardCase:
    """Cells graded towards H = 0, from not at all to the smallest numbers there are."""
    process, reference, nodes = _reference()
    solved = []
    for decades in (0, 3, 15, 300):
        graded = np.append(0.0, nodes[-1] * np.logspace(-decades, 0.0, 200)) if decades else None
        mesh = np.linspace(0.0, nodes[-1], 201) if graded is None else graded
        solved.append((f"{decades} decades", solve_on_mesh(process, mesh, 4)))
    hard = "cells graded towards H = 0 over none to 300 decades: sizes that underflow when squared"
    return _judged("grading", hard, solved, reference)


def short_end() -> HardCase:
    """A mesh that ends in the middle of the mass."""
    process, reference, nodes = _reference()
    solved = []
    for end in (0.02, 0.1, 0.4):
        mesh = np.linspace(0.0, end * nodes[-1], 41)
        solved.append((f"to {end:g} of the last energy", solve_on_mesh(process, mesh, 6)))
    hard = "the user ends the mesh in the middle of the mass: what is left out is put inside"
    return _judged("end too near", hard, solved, reference)


def far_end() -> HardCase:
    """A mesh that goes on where the density has underflown."""
    process, reference, nodes = _reference()
    far = np.concatenate([nodes, nodes[-1] * np.array([3.0, 10.0, 100.0, 1e4])])
    solved = [("to 10000 times the last energy", solve_on_mesh(process, far, 8))]
    hard = "the user ends the mesh where p is far below the smallest number"
    return _judged("end too far", hard, solved, reference)


CASES = (rigid_limit, degrees, meshes, gradings, short_end, far_end)
SLOW = (meshes,)
"""A million cells take a minute."""
