"""Hard cases of the simulation: stiff stops, steps, few and many trajectories, nothing lost."""

from dataclasses import replace
from functools import partial

import numpy as np
from hard_case import Check, HardCase
from hard_noiseless import no_noise, nothing_lost
from hard_plain import plain_euler
from hard_systems import with_stops
from numpy.typing import NDArray

from averaging.theory import Exact
from cases.compare.compare import compared
from cases.scene.scene import load_scene
from fpk.answer.density import Density
from fpk.answer.names import parse_observable
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.errors import InvalidInput, NotCertified
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.sample.ensemble import Ensemble
from sim.step.arrays import MAX_TRAJECTORIES
from sim.step.schemes import SCHEMES
from sim.step.step_size import chosen_step

SHORT = MonteCarlo(paths=4096, relaxations=10.0, burn_in=5.0)
"""A simulation of a second or two."""

Array = NDArray[np.float64]

EULER_STEP, EULER_TIME, EULER_PATHS = 0.01, 50.0, 1000


def against_exact(system: System, method: MonteCarlo) -> tuple[list[Check], SampledDensity]:
    """Certificate of the simulation and its distance to the exact p(q2)."""
    q2 = [parse_observable("q2", system.n)]
    exact, sampled = Exact().solve(system, q2), method.solve(system, q2)
    (comparison,) = compared([exact, sampled], averaging_is_exact=True)
    truth, histogram = exact.densities[0], sampled.densities[0]
    assert isinstance(truth, Density) and isinstance(histogram, SampledDensity)
    band = comparison.band or 0.0
    checks = [
        Check(
            "certified", histogram.certificate.certified, "; ".join(histogram.certificate.failures)
        ),
        Check(
            "p(q2) is the exact one", comparison.holds, f"L1 {comparison.L1:.2g}, band {band:.2g}"
        ),
    ]
    if not system.contacts:
        return checks, histogram
    share, expected = beyond_clearance(system, histogram), beyond_clearance(system, truth)
    # What lies beyond the stops is a part of what lies anywhere: the same band holds for it.
    return [
        *checks,
        Check(
            "share of time in contact",
            abs(share - expected) <= band,
            f"{share:.5f}, exact {expected:.5f}",
        ),
    ], histogram


def beyond_clearance(system: System, density: Density | SampledDensity) -> float:
    """Return the probability of |q2| > δ, of a histogram by linear interpolation in its bins."""
    clearance = system.contacts[0].clearance
    if isinstance(density, Density):
        edges = np.array([-clearance, clearance])
        return 1.0 - float(density.cell_averages(edges)[0] * 2.0 * clearance)
    (edges,) = density.edges
    below = np.concatenate([[0.0], np.cumsum(density.values * np.diff(edges))])
    inside = np.interp([-clearance, clearance], edges, below)
    return 1.0 - float(inside[1] - inside[0])


def stiff(stiffness: float) -> HardCase:
    """A stiff stop, simulated with the step that the program chooses."""
    system = with_stops(stiffness)
    checks, histogram = against_exact(system, SHORT)
    lost, state = plain_euler(system, dt=EULER_STEP, time=EULER_TIME, paths=EULER_PATHS)
    outside = float(np.mean(np.abs(state[:, 1]) > system.contacts[0].clearance))
    return HardCase(
        name=f"simulation, B = {stiffness:.0e}",
        hard="the contact is over in a thousandth of a period, and a step too long feeds energy in",
        plain=f"Euler-Maruyama, dt = {EULER_STEP}: {lost:.1%} of the paths lost,"
        f" {outside:.1%} of the others in contact",
        ours=checks[1].measured + "; in contact " + checks[2].measured,
        certificate="certified" if histogram.certificate.certified else checks[0].measured,
        checks=tuple(checks),
    )


def seeded(seed: int) -> HardCase:
    """A seed at the end of its range, or 0."""
    system = with_stops(10.0)
    checks, histogram = against_exact(system, replace(SHORT, seed=seed))
    return HardCase(
        name=f"seed {seed}",
        hard="a counter-based generator must not repeat itself where the seed mixes in no bits",
        plain="not run",
        ours=checks[1].measured,
        certificate="certified" if histogram.certificate.certified else checks[0].measured,
        checks=tuple(checks),
    )


def two_humps() -> HardCase:
    """Two humps of the energy with rare passages: right, or said not to be."""
    scene = load_scene("bistable")
    (_, exact), histogram = against_exact(scene.system, SHORT)
    words = "; ".join(histogram.certificate.failures)
    honest = exact.holds or bool(words)
    return HardCase(
        name="simulation, bistable",
        hard="passages between the humps are rarer than any decay time of the chain",
        plain="not run",
        ours=exact.measured,
        certificate=words or "certified",
        checks=(Check("the exact p(q2), or not certified", honest, exact.measured),),
    )


def too_long_a_step() -> HardCase:
    """A step beyond the stability limit: refused, or marked where the user insists."""
    system = with_stops(1e5)
    try:
        replace(SHORT, dt=0.5).solve(system, [])
        refusal = "taken"
    except InvalidInput as error:
        refusal = str(error)
    q2 = [parse_observable("q2", system.n)]
    try:
        replace(SHORT, dt=0.5, allow_unstable=True).solve(system, q2)
        words = "taken"
    except NotCertified as error:
        words = str(error)
    lost, _ = plain_euler(system, dt=0.5, time=EULER_TIME, paths=EULER_PATHS)
    return HardCase(
        name="step beyond the limit",
        hard="dt = 0.5 where the stability limit is 0.02",
        plain=f"Euler-Maruyama: {lost:.0%} of the paths lost, without a word",
        ours=f"refused: {refusal}",
        certificate=f"with --allow-unstable: {words}",
        checks=(
            Check("refused with the limit", "stability limit" in refusal, refusal),
            Check("ended where insisted on", "are unstable" in words, words),
        ),
    )


def one_trajectory() -> HardCase:
    """A single trajectory has no independent batches to take an error from."""
    words = "taken"
    try:
        replace(SHORT, paths=1)
    except InvalidInput as error:
        words = str(error)
    return HardCase(
        name="one trajectory",
        hard="there is nothing independent to take an error from",
        plain="a histogram without an error",
        ours="refused",
        certificate=words,
        checks=(Check("refused with what to use", "use 4096" in words, words),),
    )


def many_trajectories() -> HardCase:
    """Ten million trajectories, a few steps each."""
    paths = 10_000_000
    system = with_stops(10.0)
    ensemble = Ensemble(system, SCHEMES["exact_flow"], chosen_step(system), paths, 1, 2)
    ensemble.advance(20)
    _, p = ensemble.phase_points()
    square, finite = float(np.mean(p[:, 0] ** 2)), float(np.isfinite(ensemble.states).mean())
    gigabytes = sum(array.nbytes for array in ensemble.saved().values()) / 1e9
    # From the momenta's own law, kT = 1/8, twenty short steps do not lead far away.
    return HardCase(
        name="ten million trajectories",
        hard=f"memory, and counters: a seed has words for {MAX_TRAJECTORIES}",
        plain="not run",
        ours=f"E p1² = {square:.4f} after 20 steps, {gigabytes:.2f} GB",
        certificate="none: no density",
        checks=(
            Check("below 2 GB", gigabytes < 2.0, f"{gigabytes:.2f} GB"),
            Check("finite, none lost", finite == 1.0, f"{finite:.0%} finite"),
        ),
    )


def never_visited() -> HardCase:
    """A density asked for where no sample ever came."""
    system = with_stops(10.0)
    histogram = SHORT.solve(system, [parse_observable("q2", system.n)]).densities[0]
    assert isinstance(histogram, SampledDensity)
    density, error = histogram.at(np.array([50.0]))
    return HardCase(
        name="never visited",
        hard="a point where no sample came: its error is not 0",
        plain="0, with the error 0",
        ours=f"{density[0]:.0f} ± {error[0]:.1e}",
        certificate="; ".join(histogram.certificate.failures) or "certified",
        checks=(Check("an error is stated", bool(error[0] > 0.0), f"{error[0]:.1e}"),),
    )


QUICK = (no_noise, one_trajectory, too_long_a_step)
SLOW = (
    *(partial(stiff, B) for B in (1e3, 1e5, 1e7)),
    *(partial(seeded, seed) for seed in (0, 2**63)),
    two_humps,
    nothing_lost,
    many_trajectories,
    never_visited,
)
CASES = (*SLOW, *QUICK)
