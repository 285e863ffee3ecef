"""Hard cases of one energy that are no scenes: the rigid stop, meshes, degrees, wrong ends."""

from dataclasses import replace
from functools import partial

import numpy as np
from hard_scenes import TOL, Check, HardCase, energy_density
from scipy.integrate import quad

from averaging.energy_process import energy_process
from cases.scene.scene import load_scene
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.stationary import solve_on_mesh, solve_stationary

STIFFNESSES = 10.0 ** np.arange(2, 13, 2)
ORDER = 0.4
"""A stop of stiffness B is entered by (5 H/(2 B))^(2/5): so fast do the coefficients become those
of the rigid one."""
ENERGIES = np.array([0.2, 0.5, 2.0])
"""Above the contact energy 0.125/2 of the scene, in which ½ k_eff q² is a quarter of q²."""
MOST_CELLS, MOST_PANELS = 1_000_000, 20_000


def rigid_coefficients(system, energy):
    """Return drift and diffusion at one energy with rigid stops at ±δ, by quadrature of (27).

    Two masses, the contact on one: with the other integrated out T and Φ are integrals of
    (H − ½ k_eff q²) to the powers ½ and 3/2 over |q| <= δ, and τ = Φ/T their ratio over 3/2.
    """
    (stop, _) = system.stops
    stiffness = 1.0 / np.linalg.inv(system.stiffness_matrix)[stop.index, stop.index]
    end = min(stop.clearance, float(np.sqrt(2.0 * energy / stiffness)))
    upper, lower = (
        quad(lambda q, e=e: (energy - 0.5 * stiffness * q * q) ** e, 0.0, end, epsrel=1e-13)[0]
        for e in (1.5, 0.5)
    )
    tau = upper / lower / 1.5
    damping = float(np.sum(np.diag(system.damping) / system.mass))
    noise = float(np.sum(np.diag(system.noise_matrix) / system.mass))
    return noise - damping * tau, 2.0 * noise * tau


def rigid_limit():
    """The averaged coefficients as B grows, against those of the rigid stop."""
    system = load_scene("stiff-stops").system
    rigid, errors = np.array([rigid_coefficients(system, H) for H in ENERGIES]), []
    for B in STIFFNESSES:
        contacts = tuple(replace(c, stiffness=float(B)) for c in system.contacts)
        c = energy_process(replace(system, contacts=contacts)).coefficients(ENERGIES)
        errors.append(np.abs(np.stack([c.drift, c.diffusion], axis=1) / rigid - 1.0).max())
    orders = -np.diff(np.log(errors)) / np.diff(np.log(STIFFNESSES))
    # The next term is smaller by the depth itself, 4e-5 at the last stiffness.
    last = float(orders[-1])
    return HardCase(
        "rigid limit",
        "coefficients of B = 1e2 to 1e12 against those of the rigid stop, computed separately",
        f"relative difference {errors[0]:.1e} to {errors[-1]:.1e}",
        "none: coefficients, not a density",
        [
            Check("order 2/5 in 1/B", abs(last - ORDER) < 0.01, f"{last:.4f}"),
            Check("falls with B", bool(np.all(orders > 0.0)), f"orders {np.round(orders, 3)}"),
        ],
    )


def true_error(solution, reference):
    """L1 distance of a solution to the reference, over its mesh and beyond.

    Of a very fine mesh as many cells are taken together as leave ``MOST_PANELS``.
    """
    nodes = np.unique(np.concatenate([solution.nodes, reference.panels[0]]))
    if nodes.size > MOST_PANELS:
        nodes = np.append(nodes[:: nodes.size // MOST_PANELS], nodes[-1])
    H, w = (x.ravel() for x in panel_rule(nodes[nodes >= 0.0], 8))
    return float(np.sum(w * np.abs(solution.density(H) - reference.pdf(H))))


def judged(name, settings):
    """One case from several meshes: each solution finite, its error no larger than it states.

    ``settings`` makes labels, meshes and degrees of the nodes of a good mesh for the scene fig3b;
    its docstring says what is hard.
    """
    system = load_scene("fig3b").system
    process, reference = energy_process(system), energy_density(system, "closed-form")
    nodes, checks, measured, certified = solve_stationary(process, tol=TOL).nodes, [], [], 0
    for label, mesh, degree in settings(nodes):
        solution = solve_on_mesh(process, mesh, degree)
        error, what = true_error(solution, reference), f"{label}: true error within the stated one"
        within = error <= solution.l1_error + reference.l1_error
        checks.append(Check(what, within, f"{error:.1e}, stated {solution.l1_error:.1e}"))
        measured.append(f"{label}: {error:.0e}")
        certified += solution.certificate.certified
    honest = sum(c.holds for c in checks)
    words = f"{certified} of {len(checks)} certified, {honest} stated errors hold"
    shown = "L1 " + "; ".join(measured)
    return HardCase(name, settings.__doc__, shown, words, checks, "states no error")


def degrees(nodes):
    """degrees from 1 to 12 on the same cells: condition, round-off, the estimate at its floor"""
    return ((f"p = {p}", nodes, p) for p in range(1, 13))


def equal(nodes):
    """P2 on equal cells, 2 to 1e6: nothing is resolved, or every cell is near round-off"""
    for n in (2, 20, 2000, MOST_CELLS):
        yield f"{n} cells", np.linspace(0.0, nodes[-1], n + 1), 2


def graded(nodes):
    """cells graded towards H = 0 over none to 300 decades: sizes that underflow when squared"""
    yield "0 decades", np.linspace(0.0, nodes[-1], 201), 4
    for decades in (3, 15, 300):
        yield f"{decades} decades", nodes[-1] * np.append(0.0, np.logspace(-decades, 0.0, 200)), 4


def short(nodes):
    """the user ends the mesh in the middle of the mass: what is left out is put inside"""
    for end in (0.02, 0.1, 0.4):
        yield f"to {end:g} of the last energy", np.linspace(0.0, end * nodes[-1], 41), 6


def far(nodes):
    """the user ends the mesh where p is far below the smallest number"""
    beyond = nodes[-1] * np.array([3.0, 10.0, 100.0, 1e4])
    yield "to 10000 times the last energy", np.concatenate([nodes, beyond]), 8


JUDGED = {
    "degrees": degrees,
    "meshes": equal,
    "grading": graded,
    "end too near": short,
    "end too far": far,
}
CASES = (rigid_limit, *(partial(judged, *of) for of in JUDGED.items()))
SLOW = (CASES[2],)
"""A million cells take a minute."""
