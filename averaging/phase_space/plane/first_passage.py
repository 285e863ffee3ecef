"""First passage of one mass, on successive meshes until two of them agree."""

from typing import Any

import numpy as np

from averaging.phase_space.plane.elements import (
    RELIABILITY_SHARE,
    Elements,
    assemble_backward,
)
from averaging.phase_space.plane.mesh import box_mesh, energy_mesh
from averaging.phase_space.plane.oscillator import (
    FALL,
    HIGHER,
    Oscillator,
    States,
    averaged_fall,
    oscillator_of,
    require_total,
    start_states,
)
from fpk.answer.certificate import DISTANCE_FACTOR, tolerance
from fpk.answer.dynamics import Passage, certify_passage, require_times
from fpk.answer.names import Limit
from fpk.answer.quantities import Number
from fpk.answer.question import Asked
from fpk.numeric.arrays import EPS, ROUND_OFF, ROUNDINGS, Array
from fpk.numeric.errors import InvalidInput, NotCertified

TOL, GLANCING_TOL = 1e-6, 1e-5
"""Default tolerances: for a limit of the energy, and of q or v, which takes longer."""
MOST_PASSAGE_UNKNOWNS = 110_000
"""Largest number of unknowns of a mesh, which takes a minute and a gigabyte; unknowns double from
one level to the next and errors fall by factors of 15 to 1000."""
CHANCE_SHARE = 0.5
"""Least error of each quantity as a share of the largest relative difference of all quantities of
two levels: one quantity may agree by chance."""
Level = tuple[Array, Array, Array, float, dict[str, Any]]
"""Results on one mesh: (E T, E T², rate of failure, E T of each probe over E T of the start); P(T
<= t) at the times; its change by the last Krylov vectors and by what leaves the mesh where there is
no limit; the same relative to the first three, and round-off; and named arguments for
``certify_passage``."""


def phase_space_passage(asked: Asked) -> Passage:
    """Return mean, variance, rate of the first passage ``asked`` for, and P(T <= t) at times.

    Meshes are refined until two successive levels agree to the tolerance, relative for mean,
    variance and rate, absolute for probabilities; if ``MOST_PASSAGE_UNKNOWNS`` ends this, the last
    answer is returned with a failed certificate. Raises as ``fpk.answer.question`` says, and
    ``NotCertified`` if the density falls below round-off up to the limit or the start, or if fewer
    than two meshes are within ``MOST_PASSAGE_UNKNOWNS``.
    """
    times, o = require_times(asked.times), oscillator_of(asked.system)
    limit, start = asked.limit, asked.start
    require_total("limit", limit, asked.system)
    of_energy = limit.of_energy
    within = None if of_energy else limit
    energy, states = start_states(o, start, asked.system, within)
    top = limit.value if of_energy else min(H for _, H in o.ends_of(limit))
    if (of_energy and energy >= (1.0 - ROUND_OFF) * top) or not states(1)[2].size:
        raise InvalidInput("start", str(start), "is at or beyond the limit")
    tol = tolerance(asked.tol, TOL if of_energy else GLANCING_TOL)
    psi = averaged_fall(o, max(top, energy))
    for what, height in (("limit", top), ("energy of the start", energy)):
        if (fall := psi(height)) > FALL:
            words = f"up to it the density falls by exp(−{fall:.0f})"
            raise NotCertified(f"the {what} is hardly ever passed: {words}; take a lower one")
    inside = limit.bounds[0] < 0.0 < limit.bounds[1]
    highest, level, escaping = max(top, energy), 0, RELIABILITY_SHARE * tol
    probes = _probes(o, limit, top if of_energy or inside else energy)
    previous: Level | None = None
    answer: Passage | None = None
    while True:
        own = o, limit, highest, level
        mesh = energy_mesh(o, top, level) if of_energy else box_mesh(*own, rest=escaping)
        if mesh.unknowns > MOST_PASSAGE_UNKNOWNS:
            break
        e, begin = assemble_backward(mesh), states(4 * (mesh.degree + 1))
        escape = 0.0 if of_energy else e.escape(e.at(*begin))
        if not escape <= escaping:
            highest *= HIGHER
            continue
        results = _level_results(e, begin, probes, times, tol, escape)
        if previous is not None:
            answer = _compare_levels(previous, results, times, tol)
            if answer.certificate.certified:
                break
        previous = results
        asked.progress(mesh.unknowns, MOST_PASSAGE_UNKNOWNS, "first passage")
        level += 1
    if answer is None:
        raise NotCertified("the motion is too finely structured: light noise, or stiff stops")
    return answer


def _probes(o: Oscillator, limit: Limit, height: float) -> tuple[Array, Array]:
    """Return q and v (8,) half-way from the middle to the ends of motions of the energy ``height``
    within the ``limit``."""
    fastest = float(np.sqrt(2.0 * height / o.mass))
    ends = np.array([[o.turning_point(height, side) for side in (-1.0, 1.0)], [-fastest, fastest]])
    if not limit.of_energy:
        row = "qv".index(limit.kind)
        ends[row] = np.clip(ends[row], *limit.bounds)
    angle = 0.25 * np.pi * np.arange(8)
    q, v = ends.mean(axis=1)[:, None] + 0.25 * np.diff(ends) * [np.cos(angle), np.sin(angle)]
    return q, v


def _level_results(
    e: Elements,
    states: States,
    probes: tuple[Array, Array],
    times: Array,
    tol: float,
    escape: float,
) -> Level:
    """Return the results on the mesh of ``e`` for a start in the weighted ``states``.

    ``probes`` are (q, v) of further states, whose mean times are compared. Krylov spaces serve the
    tolerance ``tol`` at ``times``. ``escape``: see ``Elements.escape``.
    """
    start, later = e.at(*states), times > 0.0
    mean, second, lost = e.moments(start)
    own = float(start @ e.mean)
    failure, krylov = np.full(times.size, 1.0 - float(states[2].sum())), np.zeros(times.size)
    if np.any(later):
        # M F' = −K F + exit, F(0) = 0; at H = E, where there are no unknowns, F = 1.
        given = 0.0 * start, e.exit, e.one, times[later]
        F, krylov[later] = e.in_time(*given, tol=tol, seen=start)
        failure[later] = F + (1.0 - float(start @ e.one))
    others = [e.at(q[None], v[None], np.ones(1)) @ e.mean for q, v in zip(*probes, strict=True)]
    settings = e.mesh.settings(e.load.size, "of the backward equation")
    settings["mass that round-off took"] = lost
    defect = np.max(np.abs(e.load - e.K @ e.mean)) / np.max(abs(e.K) @ np.abs(e.mean))
    stated = {"mass_defect": e.mass_defect(start), "residual": float(defect), "settings": settings}
    numbers = np.array([mean, second, e.slowest[0], *(np.array(others) / own)])
    # What leaves the mesh elsewhere would fail later, after the time from there.
    rounding = ROUNDINGS * EPS + (own / mean - 1.0) ** 2 + escape * max(1.0, *numbers[3:])
    return numbers, failure, krylov + escape, rounding, stated


def _compare_levels(coarse: Level, fine: Level, times: Array, tol: float) -> Passage:
    """Return the finer results at ``times`` as an answer with a certificate for ``tol``.

    The errors are the difference to the coarser results times ``DISTANCE_FACTOR``, and round-off.
    """
    numbers, failure, krylov, rounding, stated = fine
    before, failure_before, krylov_before, _, stated_before = coarse
    stated = {**stated, "residual": max(stated["residual"], stated_before["residual"])}
    change = np.abs(numbers - before)
    share = np.max(change / np.abs(numbers))
    values, scale, off = numbers[:3].copy(), numbers[:3].copy(), change[:3]
    values[1] -= values[0] ** 2
    scale[1] += values[0] ** 2
    off[1] = abs(values[1] - (before[1] - before[0] ** 2))
    errors = DISTANCE_FACTOR * np.maximum(off, CHANCE_SHARE * share * np.abs(values))
    errors += rounding * scale
    apart = np.abs(failure - failure_before)
    lost = DISTANCE_FACTOR * np.maximum(apart, CHANCE_SHARE * np.max(apart, initial=0.0))
    lost += krylov + krylov_before + ROUNDINGS * EPS * (times > 0.0)
    mean, variance, rate = (Number(float(x), float(e)) for x, e in zip(values, errors, strict=True))
    return certify_passage((mean, variance, rate), times, failure, lost, tol=tol, **stated)
