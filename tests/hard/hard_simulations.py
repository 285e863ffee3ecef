"""Hard cases of the simulation: stiff stops, steps, few and many trajectories, no noise."""

from dataclasses import replace
from functools import partial

import numpy as np
from hard_scenes import Check, HardCase

from averaging.theory import Exact
from cases.compare.compare import compare_densities
from cases.scene.scene import load_scene
from fpk.answer.contacts import contact_quantity
from fpk.answer.names import parse_observable
from fpk.numeric.errors import InvalidInput, NotCertified
from sim.montecarlo import MonteCarlo
from sim.sample.ensemble import Ensemble
from sim.step.arrays import LANES, MAX_TRAJECTORIES
from sim.step.schemes import SCHEMES
from sim.step.step_size import chosen_step

SHORT = MonteCarlo(paths=4096, relaxations=10.0, burn_in=5.0)
"""A simulation of a second or two."""
EULER_STEP, EULER_TIME, EULER_PATHS = 0.01, 50.0, 1000
MANY_STEPS = 1_000_000
Q2 = [parse_observable("q2", 2)]


def with_stops(stiffness):
    """Return the system of ``stiff-stops``, for which (7) is exact, with stops of ``stiffness``."""
    system = load_scene("stiff-stops").system
    return replace(system, contacts=tuple(replace(c, stiffness=stiffness) for c in system.contacts))


def pushed(system, q):
    """Forces of the stops on the masses at displacements (paths, n)."""
    force = np.zeros_like(q)
    for stop in system.stops:
        overlap = np.maximum(stop.sign * q[:, stop.index] - stop.clearance, 0.0)
        force[:, stop.index] -= stop.sign * stop.force(overlap)
    return force


def plain_euler(system, *, dt, seed=1):
    """Return the share of lost paths and the final states (paths, 2n) of Euler-Maruyama in NumPy.

    Constant damping; every path starts at rest.
    """
    generator, n, m = np.random.default_rng(seed), system.n, system.mass
    root = np.linalg.cholesky(2.0 * dt * system.noise_matrix + 1e-300 * np.eye(n))
    q, p = np.zeros((EULER_PATHS, n)), np.zeros((EULER_PATHS, n))
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(round(EULER_TIME / dt)):
            force = pushed(system, q) - q @ system.stiffness_matrix - (p / m) @ system.damping.T
            noise = generator.standard_normal((EULER_PATHS, n)) @ root.T
            q, p = q + dt * p / m, p + dt * force + noise
    finite = np.all(np.isfinite(q) & np.isfinite(p), axis=1)
    return 1.0 - float(finite.mean()), np.hstack([q, p])


def refusal(error, made):
    """What ``made`` says when it raises ``error``."""
    try:
        made()
    except error as reason:
        return str(reason)
    return "taken"


def against_exact(system, method):
    """Certificate of the simulation and its distance to the exact p(q2), and its words."""
    exact, sampled = Exact().solve(system, Q2), method.solve(system, Q2)
    (comparison,) = compare_densities([exact, sampled], averaging_is_exact=True)
    truth, histogram = exact.densities[0], sampled.densities[0]
    words, band = "; ".join(histogram.certificate.failures), comparison.band or 0.0
    measured = f"L1 {comparison.L1:.2g}, band {band:.2g}"
    checks = [
        Check("certified", histogram.certificate.certified, words),
        Check("p(q2) is the exact one", comparison.holds, measured),
    ]
    if system.contacts:
        names = ["contact probability"] * len(system.stops)
        share, expected = (
            sum(contact_quantity(*of, p).value for of in zip(names, system.stops, strict=True))
            for p in (histogram, truth)
        )
        # What lies beyond the stops is a part of what lies anywhere: the same band holds for it.
        inside, shown = abs(share - expected) <= band, f"{share:.5f}, exact {expected:.5f}"
        checks.append(Check("share of time in contact", inside, shown))
    return checks, words or "certified"


def stiff(stiffness):
    """A stiff stop, simulated with the step that the program chooses."""
    system = with_stops(stiffness)
    checks, words = against_exact(system, SHORT)
    lost, state = plain_euler(system, dt=EULER_STEP)
    outside = float(np.mean(np.abs(state[:, 1]) > system.contacts[0].clearance))
    return HardCase(
        f"simulation, B = {stiffness:.0e}",
        "the contact is over in a thousandth of a period, and a step too long feeds energy in",
        checks[1].measured + "; in contact " + checks[2].measured,
        words,
        checks,
        f"Euler-Maruyama, dt = {EULER_STEP}: {lost:.1%} of the paths lost,"
        f" {outside:.1%} of the others in contact",
    )


def two_humps():
    """Two humps of the energy with rare passages: right, or said not to be."""
    (_, exact), words = against_exact(load_scene("bistable").system, SHORT)
    honest = exact.holds or words != "certified"
    hard = "passages between the humps are rarer than any decay time of the chain"
    checks = [Check("the exact p(q2), or not certified", honest, exact.measured)]
    return HardCase("simulation, bistable", hard, exact.measured, words, checks)


def too_long_a_step():
    """A step beyond the stability limit: refused, or marked where the user insists."""
    system, long = with_stops(1e5), replace(SHORT, dt=0.5)
    refused = refusal(InvalidInput, lambda: long.solve(system, []))
    insisting = replace(long, allow_unstable=True)
    words = refusal(NotCertified, lambda: insisting.solve(system, Q2))
    lost, _ = plain_euler(system, dt=0.5)
    return HardCase(
        "step beyond the limit",
        "dt = 0.5 where the stability limit is 0.02",
        f"refused: {refused}",
        f"with --allow-unstable: {words}",
        [
            Check("refused with the limit", "stability limit" in refused, refused),
            Check("ended where insisted on", "are unstable" in words, words),
        ],
        f"Euler-Maruyama: {lost:.0%} of the paths lost, without a word",
    )


def many_trajectories():
    """Ten million trajectories, a few steps each."""
    system = with_stops(10.0)
    ensemble = Ensemble(system, SCHEMES["exact_flow"], chosen_step(system), 10_000_000, 1, 2)
    ensemble.advance(20)
    _, p = ensemble.phase_points()
    square, finite = float(np.mean(p[:, 0] ** 2)), float(np.isfinite(ensemble.states).mean())
    gigabytes = sum(array.nbytes for array in ensemble.saved().values()) / 1e9
    # From the momenta's own law, kT = 1/8, twenty short steps do not lead far away.
    return HardCase(
        "ten million trajectories",
        f"memory, and counters: a seed has words for {MAX_TRAJECTORIES}",
        f"E p1² = {square:.4f} after 20 steps, {gigabytes:.2f} GB",
        "none: no density",
        [
            Check("below 2 GB", gigabytes < 2.0, f"{gigabytes:.2f} GB"),
            Check("finite, none lost", finite == 1.0, f"{finite:.0%} finite"),
        ],
    )


def released(damping, dt):
    """A system without noise and its trajectories, at rest in the stops and beside them."""
    system = with_stops(10.0)
    none = 0.0 * system.noise_intensity
    system = replace(system, damping=damping * system.damping, noise_intensity=none)
    ensemble = Ensemble(system, SCHEMES["exact_flow"], dt, LANES, 1, 1)
    states = 0.0 * ensemble.states
    states[0, 1] = np.linspace(-0.7, 0.7, LANES)
    ensemble.restore({**ensemble.saved(), "states": states})
    ensemble.energy = float(np.max(energies(system, ensemble)))
    return system, ensemble


def energies(system, ensemble):
    """H of all trajectories half a kick on: states are stored just before one."""
    q, p = ensemble.phase_points()
    return system.hamiltonian(q, p + 0.5 * ensemble.dt * pushed(system, q))


def no_noise():
    """Damping without noise: the energy falls, and there is no density to ask for."""
    dt, levels = chosen_step(with_stops(10.0)), []
    system, ensemble = released(1.0, dt)
    for _ in range(200):
        ensemble.advance(round(1.0 / dt))
        levels.append(energies(system, ensemble))
    levels = np.array(levels)
    first, last = float(levels[0].max()), float(levels[-1].max())
    # Between two samples the energy of a step may stand above its mean by (ω dt)²/8 or so.
    rise = float(np.max(levels[1:] - 1.1 * levels[:-1])) - 1e-12 * first
    reason = MonteCarlo().refusal(system, Q2[0]) or "taken"
    return HardCase(
        "no noise",
        "the state decays into a point: no stationary density",
        f"energy {first:.2g} to {last:.1e}; densities refused",
        reason,
        [
            Check("the energy falls", rise <= 0.0, f"largest rise beyond the step's {rise:.1e}"),
            Check("and away", last < 1e-3 * first, "see above"),
            Check("densities refuse", "no noise" in reason, reason),
        ],
    )


def nothing_lost():
    """No damping, no noise: the energy after a million steps."""
    drifts = []
    for part in (4.0, 8.0):
        system, ensemble = released(0.0, chosen_step(with_stops(10.0)) / part)
        before, worst = energies(system, ensemble), 0.0
        for _ in range(10):
            ensemble.advance(MANY_STEPS // 10)
            change = np.abs(energies(system, ensemble) - before)
            worst = max(worst, float(np.max(change) / before.max()))
        drifts.append(worst)
    # A symmetric scheme keeps a Hamiltonian that differs from H by (ω dt)²; where a stop is touched
    # its force has no second derivative, and what that adds at random is of a higher order.
    (drift, finer), bound = drifts, (0.45 / 4.0) ** 2
    ratio = drift / finer
    return HardCase(
        "no damping, no noise",
        "a million steps in and out of contact, in which a drift of the energy would add up",
        f"change of the energy {drift:.1e} at a quarter of the step, {finer:.1e} at an eighth, of"
        " the largest",
        "none: no density",
        [
            Check("bounded by (ω dt)²", drift < bound, f"{drift:.1e}, bound {bound:.1e}"),
            Check("of second order at least", ratio > 3.0, f"halved step: {ratio:.1f} times less"),
        ],
    )


QUICK = (no_noise, too_long_a_step)
SLOW = (
    *(partial(stiff, B) for B in (1e3, 1e5, 1e7)),
    two_humps,
    nothing_lost,
    many_trajectories,
)
CASES = (*SLOW, *QUICK)
