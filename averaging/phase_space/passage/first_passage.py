"""First passage of one mass, refined until two levels of meshes agree."""

from typing import NamedTuple

import numpy as np

from averaging.phase_space.passage.elements import elements
from averaging.phase_space.passage.mesh import DEGREES
from averaging.phase_space.passage.oscillator import oscillator_of
from averaging.phase_space.passage.solution import Solution
from averaging.phase_space.passage.states import Region, Source, region_of, source_of
from fpk.arrays import EPS, Array
from fpk.certificate import tolerance
from fpk.errors import NotCertified
from fpk.evolution import Passage, PassageAsked, certified_passage, checked_times
from fpk.number import Number

TOL, GLANCING_TOL = 1e-6, 1e-5
"""Error wanted where none is asked for: of an energy; of a displacement, which takes ten times as
many unknowns."""
HIGHEST = 36.0
"""Largest fall of −ln p up to the limit: beyond it mean times are lost to round-off."""
LEVELS = len(DEGREES)
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
ROUNDING = 16.0
"""Roundings of a sum that are always stated."""


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


def first_passage(asked: PassageAsked) -> Passage:
    """Return the first passage that is asked for, with the reliability at its times.

    Levels of meshes rise until two agree to the tolerance, relative to mean, variance and rate,
    absolute in the reliability; the answer is that of the finer one. Raises as the module
    ``fpk.evolution`` says, and ``NotCertified`` for a limit that is beyond what double precision
    reaches.
    """
    times = checked_times(asked.times)
    oscillator = oscillator_of(asked.system)
    region = region_of(asked.system, oscillator, asked.limit)
    source = source_of(asked.system, region, asked.start)
    tol = tolerance(asked.tol, TOL if region.of_energy else GLANCING_TOL)
    for what, height in (("limit", region.height), ("energy of the start", source.height)):
        if (fall := oscillator.inverse_temperature * height) > HIGHEST:
            words = f"up to it the density falls by exp(−{fall:.0f})"
            raise NotCertified(f"the {what} is hardly ever passed: {words}; take a lower one")
    previous: Level | None = None
    answer: Passage | None = None
    for level in range(LEVELS):
        solved = _solved(region, source, times, level, tol)
        if solved is None:
            break
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


def _solved(region: Region, source: Source, times: Array, level: int, tol: float) -> Level | None:
    mesh = region.mesh(source.fastest, level)
    if (mesh.x.size - 1) * (mesh.degree + 1) * (mesh.s.size - 1) * mesh.degree > MOST_UNKNOWNS:
        return None
    e = elements(mesh)
    solution = Solution(e)
    states = source.states(POINTS + 8 * level)
    start = e.at(*states)
    mean, second, lost = solution.moments(start)
    beyond = 1.0 - float(states[2].sum()) if source.energy is not None else 0.0
    failure, krylov = np.full(times.size, beyond), np.zeros(times.size)
    if np.any(later := times > 0.0):
        failure[later], krylov[later] = solution.failure(start, times[later], tol=tol)
    own = float(start @ solution.mean)
    return Level(
        np.array([mean, second, solution.rate()]),
        _probes(region, solution) / own,
        failure,
        krylov,
        rounding=ROUNDING * EPS + (own / mean - 1.0) ** 2,
        lost=lost,
        defect=solution.mass_defect(start),
        residual=solution.residual(),
        unknowns=e.load.size,
        degree=mesh.degree,
    )


def _probes(region: Region, solution: Solution) -> Array:
    """Mean times from states halfway to the limit, in eight directions."""
    o, height = region.oscillator, 0.25 * region.height
    sides = o.turning_points(height)
    angle = 0.25 * np.pi * np.arange(8)
    q = np.where(np.cos(angle) > 0.0, sides[1], -sides[0]) * np.cos(angle)
    v = np.sqrt(2.0 * height / o.mass) * np.sin(angle)
    at, one = solution.elements.at, np.ones(1)
    return np.array([at(q[k : k + 1], v[k : k + 1], one) @ solution.mean for k in range(8)])


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
    lost += fine.krylov + coarse.krylov + ROUNDING * EPS * (times > 0.0)
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
