"""Certified densities of one energy in time under modulated noise."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.integrate import solve_ivp

from fpk.arrays import SMALLEST, Array
from fpk.certificate import certify
from fpk.errors import InvalidInput, NotApplicable
from fpk.evolution import NO_NOISE_YET, UNRESOLVED, Transient
from fpk.line.time.elements import Elements
from fpk.line.time.propagation import Solution, Source
from fpk.line.time.stepping import STAGES, stepped
from fpk.line.time.transition import SAFETY, Settings, Transition, adapted, judged, posed
from fpk.modulation import Modulation
from fpk.observable import number_text
from fpk.process import Process

LEVELS = (1, 4)
"""Halvings of all steps: those with which the mesh is adapted, and the most."""
ODE_TOLS = (1e-12, 1e-10)
"""Tolerances of two solutions of dH/dt = F(H): the answer, and one whose distance is its error."""


def modulated_transient(
    under: Callable[[float], Process],
    modulation: Modulation,
    source: Source,
    times: Array,
    at: Array,
    *,
    tol: float,
) -> Transient:
    """Return the densities at energies ``at``; all else as of ``modulated_transition``.

    Where the modulation ends with 0, those at later times are carried along from its end by
    ``free_decay``. Where what is estimated exceeds ``UNRESOLVED`` errors are infinite. Raises
    ``NotApplicable`` as ``free_decay`` does.
    """
    end = float(modulation.times[-1]) if modulation.largest and not modulation.last else np.inf
    later = times > end
    stops = np.unique(np.minimum(times, end))
    solved = modulated_transition(under, modulation, source, stops, tol=tol)
    values, errors = np.zeros((2, times.size, at.size))
    values[~later], errors[~later] = (a[: int((~later).sum())] for a in solved.density(at))
    measured, process = solved.measured, under(1.0)
    for k in np.flatnonzero(later):
        values[k], errors[k], l1 = free_decay(process, solved, float(times[k] - end), at)
        largest = np.max([measured.l1_error, solved.measured.l1_error + l1])
        measured = replace(measured, l1_error=float(largest))
    if not measured.l1_error <= UNRESOLVED:
        errors[:] = np.inf
    certificate = certify(measured, tol=solved.question.tol)
    return Transient(times, values, errors, "numerical", certificate, solved.settings)


def free_decay(
    process: Process, solved: Transition, time: float, at: Array
) -> tuple[Array, Array, float]:
    """Return p at energies ``at``, its error, and the L1 error that the ``time`` of decay adds.

    Without noise dH/dt = F(H) leads from H_0 to H, so that p(H, t) dH = p(H_0, 0) dH_0, where
    dH_0/dH = F(H_0)/F(H). Raises ``NotApplicable`` where damping feeds energy in.
    """
    e = solved.elements
    inner = e.x.ravel()
    if np.any(process.coefficients(inner).dissipation >= 0.0):
        raise NotApplicable("damping feeds energy in: after the end of the noise fem has no answer")
    H, positive = process.on_mesh(at, float(np.max(at, initial=e.right[-1])))
    z = np.log(H)

    def rate(_: float, z: Array) -> Array:
        # Beyond the last element there is nothing.
        energy = np.exp(np.minimum(z, np.log(e.right[-1])))
        return np.asarray(-process.coefficients(energy).dissipation / energy)

    ends = [
        solve_ivp(rate, (0.0, time), z, method="DOP853", rtol=rtol, atol=rtol).y[:, -1]
        for rtol in ODE_TOLS
    ]
    began = np.exp(ends[0])
    jacobian = began * rate(0.0, ends[0]) / (H * rate(0.0, z))
    inside = np.minimum(began, e.right[-1])
    # An error of F by ε shifts ln H_0 by ε F/H t.
    relative = float(e.relative_error.max())
    fastest = float(np.max(rate(0.0, np.log(inner))))
    moved = float(np.max(np.abs(ends[0] - ends[1]), initial=0.0)) + relative * fastest * time
    p, error = (a[-1] for a in solved.density(began))
    shifted = solved.density(np.minimum(inside * np.exp(moved), e.right[-1]))[0][-1]
    changed = np.abs(shifted - p) * (began <= e.right[-1]) + (moved + 2.0 * relative) * np.abs(p)
    # The variation of the density of ln H, of one or two maxima.
    height = float(np.max(np.abs(solved.solution.density(inner)[0][-1]) * inner))
    # Beyond the last element p falls faster than 1/H.
    error = error * inside / began
    values, errors = jacobian * p, jacobian * (error + SAFETY * changed)
    return (
        np.where(positive, values, 0.0),
        np.where(at >= 0.0, errors + SMALLEST, 0.0),
        (4.0 * SAFETY * moved * height + 2.0 * relative),
    )


def modulated_transition(
    under: Callable[[float], Process],
    modulation: Modulation,
    source: Source,
    times: Array,
    *,
    tol: float,
) -> Transition:
    """Return the density at ``times`` > 0 after ``source``; ``under(F)`` has F times the noise.

    By steps of Radau IIA of the order 9 on elements that adapt; the error is the distance to
    elements of a higher degree and to steps twice as long, and settings have the order that the
    last three levels of steps show. Without noise it is the equation of the decay alone, of first
    order. Raises ``InvalidInput`` for times at which the density is still one energy, and as
    ``begins`` and ``posed`` do.
    """
    quiet = begins(modulation, source)
    if times[0] <= quiet:
        raise InvalidInput("times", float(times[0]), NO_NOISE_YET)
    modulation, times = modulation.after(quiet), times - quiet
    unit = modulation.largest or 1.0
    process, first = under(unit), float(modulation.energy(times[0])) / unit
    question, pair = posed(process, source, first, tol)

    @lru_cache(maxsize=len(pair))
    def carried(e: Elements, level: int) -> Solution:
        g = stepped(e, source.load(e), modulation, unit, times, level=level).g
        return Solution(process, e, g)

    solved = adapted(question, pair, lambda e, **_: carried(e, LEVELS[0]))
    e, finer = solved.pair
    x, w = e.x, e.weight

    def values(level: int) -> Array:
        return carried(e, level).density(x.ravel())[0].reshape(solved.distance.shape)

    def l1(moved: Array, _: Array) -> float:
        return float((moved * w).sum(axis=(1, 2)).max())

    level, _, moved, distances = halved(values, l1, 0.25 * tol)
    own = carried(e, level)
    # In steps twice as long, so that what is compared with it sees the error of both.
    enriched = solved.enriched if level - 1 == LEVELS[0] else carried(finer, level - 1)
    solved, _, _ = judged(question, own, enriched, distance=solved.distance + moved)
    # At the ends of elements, where no point is, distances are largest while there is no noise.
    at_ends = np.abs(own.density(e.right)[0] - enriched.density(e.right)[0])
    beside = np.maximum(at_ends, np.append(0.0 * at_ends[:, :1], at_ends[:, :-1], axis=1))
    return replace(
        solved,
        distance=np.maximum(solved.distance, beside[..., None]),
        settings={**solved.settings, **settings_of(e, level, distances, tol)},
    )


def halved(
    values: Callable[[int], Array], size: Callable[[Array, Array], float], wanted: float
) -> tuple[int, Array, Array, list[float]]:
    """Halve all steps until the ``values(level)`` change by no more than ``wanted``.

    ``size(changes, values)`` is what counts of the absolute changes. Returned are the last level
    and its values and changes, and the sizes of the changes at all levels.
    """
    finer, sizes = values(LEVELS[0]), []
    for level in range(LEVELS[0] + 1, LEVELS[1] + 1):
        coarse, finer = finer, values(level)
        moved = np.abs(finer - coarse)
        sizes.append(size(moved, finer))
        if SAFETY * sizes[-1] <= wanted:
            break
    return level, finer, moved, sizes


def settings_of(e: Elements, level: int, sizes: list[float], tol: float) -> Settings:
    """Return the settings: elements, halvings of steps, and the order that their sizes show."""
    settings: Settings = {
        "equation": f"modulated noise, Radau IIA of order {2 * STAGES - 1}",
        "elements": e.count,
        "halvings of the steps": level,
        "tol": tol,
    }
    if len(sizes) > 1 and sizes[-1] > 0.0:
        settings["observed order"] = math.log2(sizes[-2] / sizes[-1])
    return settings


def begins(modulation: Modulation, source: Source) -> float:
    """Return the time at which the density of ``source`` begins to change.

    Raises ``InvalidInput`` for an energy > 0 that decays before there is any noise.
    """
    if source.process is not None:
        return 0.0
    quiet = modulation.quiet
    if quiet > 0.0 and source.energy > 0.0:
        remedy = f"decays without noise until t = {quiet:g}; begin there, at rest or from noise=F"
        raise InvalidInput("start", f"H={number_text(source.energy)}", remedy)
    return quiet
