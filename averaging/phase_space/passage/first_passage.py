"""First passage of one mass, refined until two levels of meshes agree."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from averaging.phase_space.passage.elements import Elements, elements
from averaging.phase_space.passage.mesh import (
    Oscillator,
    displacement_mesh,
    energy_mesh,
    oscillator_of,
)
from fpk.answer.certificate import tolerance
from fpk.answer.evolution import Passage, certified_passage, checked_times
from fpk.answer.quantities import Number
from fpk.answer.question import Asked
from fpk.numeric.arrays import EPS, Array
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.numeric.quadrature import panel_rule

TOL, GLANCING_TOL = 1e-6, 1e-5
"""Error wanted where none is asked for: of an energy; of a displacement, which takes ten times as
many unknowns."""
HIGHEST = 36.0
"""Largest fall of −ln p up to the limit: beyond it mean times are lost to round-off."""
LEVELS = 6
"""Levels of meshes; unknowns double from one to the next, errors fall by 15 to 1000."""
MOST_UNKNOWNS = 110_000
"""Unknowns beyond which no level is solved: a minute and a gigabyte."""
SAFETY = 3.0
"""Factor on the distance of the last two levels: where levels converge the error of the finer one
is a fifteenth of it or less, so that there is much to spare where they do not yet."""
SHARE = 0.5
"""Share of the largest relative distance that is in each error: levels agree by chance, too."""
POINTS = 24
"""Gauss points of a piece of a start of given energy on the first level; 8 more on each later."""
ROUNDING = 16.0 * EPS
"""Relative round-off that is always stated."""
AT_LIMIT = 1.0 - 1e-12
"""Share of an energy limit at which a start counts as beyond it, as in the simulation."""
MODAL = "the energy of a mode is that of one mass without stops; ask for H"

States = tuple[Array, Array, Array]
"""Displacements, velocities and weights of states."""


class Level(NamedTuple):
    """Mean, E T² and rate, the mean from other states over it, and P(T <= t), of one mesh.

    ``rounding`` is the relative round-off of the numbers, ``lost`` the share of mass that round-off
    took from the density of the time spent, before it was given back; ``defect`` what is wrong
    with the mass at a time of the order of a period.
    """

    numbers: Array
    probes: Array
    failure: Array
    krylov: Array
    rounding: float
    lost: float
    defect: float
    residual: float
    unknowns: int
    degree: int


def first_passage(asked: Asked) -> Passage:
    """Return the first passage that is asked for, with the reliability at its times.

    Levels of meshes rise until two agree to the tolerance, relative to mean, variance and rate,
    absolute in the reliability; the answer is that of the finer one. Raises as the module
    ``fpk.answer.evolution`` says, ``NotApplicable`` for other limits and starts than the method
    knows, and ``NotCertified`` for a limit that is beyond what double precision reaches.
    """
    times, o = checked_times(asked.times), oscillator_of(asked.system)
    limit, start, contacts = asked.limit, asked.start, asked.system.contacts
    if limit.kind == "modal" and contacts:
        raise NotApplicable(f"limit {limit}: {MODAL}")
    if start.kind == "noise" and start.values["noise"] > 0.0:
        raise NotApplicable("a stationary start is not solved for in phase space; use montecarlo")
    if start.kind == "modal" and contacts:
        raise NotApplicable(f"start {start}: {MODAL}")
    most, of_energy = limit.value, limit.kind != "q"
    states: Callable[[int], States]
    if start.kind in ("energy", "modal") and not start.rest:
        (energy,) = start.values.values()
        beyond = of_energy and not energy < AT_LIMIT * most
        states = partial(orbit, o, energy, None if of_energy else most)
    else:
        q, p = (x[:1] for x in start.state(1)) if start.kind == "state" else np.zeros((2, 1))
        energy = float(o.energy(q, p / o.mass)[0])
        beyond = not (energy < AT_LIMIT * most if of_energy else abs(float(q[0])) < most)
        state = np.asarray(q, dtype=float), np.asarray(p / o.mass, dtype=float), np.ones(1)

        def states(points: int) -> States:
            return state

    if beyond:
        raise InvalidInput("start", str(start), "is at or beyond the limit")
    tol = tolerance(asked.tol, TOL if of_energy else GLANCING_TOL)
    top = most if of_energy else float(o.potential(np.array([-most, most])).min())
    for what, height in (("limit", top), ("energy of the start", energy)):
        if (fall := o.inverse_temperature * height) > HIGHEST:
            words = f"up to it the density falls by exp(−{fall:.0f})"
            raise NotCertified(f"the {what} is hardly ever passed: {words}; take a lower one")
    # States halfway to the limit, in eight directions.
    left, right = o.turning_points(0.25 * top)
    angle = 0.25 * np.pi * np.arange(8)
    q = np.where(np.cos(angle) > 0.0, right, -left) * np.cos(angle)
    probes = q, np.sqrt(0.5 * top / o.mass) * np.sin(angle)
    fastest = float(np.sqrt(2.0 * energy / o.mass))
    previous: Level | None = None
    answer: Passage | None = None
    for level in range(LEVELS):
        if of_energy:
            mesh = energy_mesh(o, most, level)
        else:
            mesh = displacement_mesh(o, most, fastest, level)
        across = (mesh.s.size - 1) * mesh.degree
        if (mesh.x.size - 1) * (mesh.degree + 1) * across > MOST_UNKNOWNS:
            break
        solved = _solved(elements(mesh), states(POINTS + 8 * level), probes, times, tol)
        if previous is not None:
            later = _compared(previous, solved, times, tol)
            answer = later if answer is None else _better(answer, later)
            if later.certificate.certified:
                return later
        previous = solved
        asked.progress(level + 1, LEVELS, "first passage")
    if answer is None:
        raise NotCertified("the motion is too finely structured: light noise, or stiff stops")
    return answer


def orbit(o: Oscillator, energy: float, within: float | None, points: int) -> States:
    """Return the states of an energy with |q| < ``within``, each as long as motion stays in it.

    By ``points`` of Gauss on each piece between turning points, stops and limit: dt = dq/|v|,
    smooth in θ, q = centre + radius sin θ. Weights add up to less than 1 where part of the motion
    is beyond the limit; None: no limit of displacements.
    """
    left, right = o.turning_points(energy)
    centre, radius = 0.5 * (left + right), 0.5 * (right - left)
    cuts = [*(q for q, _ in o.stops), 0.0, *((-within, within) if within else ())]
    angles = np.arcsin([(q - centre) / radius for q in cuts if left < q < right])
    # Weights near a turning point need more digits than E − V has: pieces do not begin there.
    edges = np.unique(np.concatenate([[-0.5 * np.pi, 0.5 * np.pi], angles]))
    theta, w = (a.ravel() for a in panel_rule(edges, points))
    q = centre + radius * np.sin(theta)
    v = o.speed(q, energy)
    weights = w * radius * np.cos(theta) / v
    weights = 0.5 * weights / weights.sum()
    q, v, weights = np.tile(q, 2), np.concatenate([v, -v]), np.tile(weights, 2)
    inside = np.abs(q) < (within or np.inf)
    return q[inside], v[inside], weights[inside]


def _solved(
    e: Elements, states: States, probes: tuple[Array, Array], times: Array, tol: float
) -> Level:
    start = e.at(*states)
    mean, second, lost = e.moments(start)
    own = float(start @ e.mean)
    failure, krylov = np.full(times.size, 1.0 - float(states[2].sum())), np.zeros(times.size)
    if np.any(later := times > 0.0):
        failure[later], krylov[later] = e.failure(start, times[later], tol=tol)
    one = np.ones(1)
    others = [e.at(q[None], v[None], one) @ e.mean for q, v in zip(*probes, strict=True)]
    return Level(
        np.array([mean, second, e.rate()]),
        np.array(others) / own,
        failure,
        krylov,
        rounding=ROUNDING + (own / mean - 1.0) ** 2,
        lost=lost,
        defect=e.mass_defect(start),
        residual=e.residual(),
        unknowns=e.load.size,
        degree=e.mesh.degree,
    )


def _better(earlier: Passage, later: Passage) -> Passage:
    """Return the earlier answer if its error is the smaller one and the later one agrees."""
    a, b = ((bool(c.besides), c.missed or 0.0) for c in (earlier.certificate, later.certificate))
    numbers = ((earlier.mean, later.mean), (earlier.variance, later.variance))
    agreed = all(abs(x.value - y.value) <= x.error for x, y in numbers)
    apart = np.abs(earlier.survival - later.survival)
    return earlier if a <= b and agreed and np.all(apart <= earlier.survival_error) else later


def _compared(coarse: Level, fine: Level, times: Array, tol: float) -> Passage:
    """The finer answer, with its distance to the coarser one as the error."""
    (mean, second, rate), (before, second_before, _) = fine.numbers, coarse.numbers
    variance = second - mean**2
    values = np.array([mean, variance, rate])
    off = np.abs(fine.numbers - coarse.numbers)
    probes = np.abs(fine.probes / coarse.probes - 1.0)
    worst = max(float(np.max(off / np.abs(fine.numbers))), float(np.max(probes)))
    off[1] = abs(variance - (second_before - before**2))
    scale = np.array([mean, second + mean**2, rate])
    errors = SAFETY * np.maximum(off, SHARE * worst * np.abs(values)) + fine.rounding * scale
    apart = np.abs(fine.failure - coarse.failure)
    lost = SAFETY * np.maximum(apart, SHARE * np.max(apart, initial=0.0))
    lost += fine.krylov + coarse.krylov + ROUNDING * (times > 0.0)
    numbers = [Number(float(x), float(e)) for x, e in zip(values, errors, strict=True)]
    return certified_passage(
        (numbers[0], numbers[1], numbers[2]),
        times,
        fine.failure,
        lost,
        tol=tol,
        mass_defect=fine.defect,
        residual=float(np.max([fine.residual, coarse.residual])),
        settings={
            "equation": "(6)",
            "solver": "fem",
            "solved_by": "finite elements of the backward equation",
            "unknowns": fine.unknowns,
            "degree": fine.degree,
            "mass that round-off took": fine.lost,
        },
    )
