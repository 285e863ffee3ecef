"""Densities of one energy in time under modulated noise, by implicit Runge-Kutta steps.

Let π be the stationary density of a reference noise, and e² the noise intensity over that of the
reference. Then p = π g has the flux J = π ((1 − e²) F g − e² ½ b g'), F the part of the drift due
to damping, so that M ∂g/∂t = (−e² K + (1 − e²) C) g.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
from numpy.polynomial.legendre import legint, legvander
from scipy.integrate import solve_ivp
from scipy.sparse import csc_array, kron
from scipy.sparse.linalg import splu
from scipy.special import roots_jacobi

from fpk.answer.certificate import DISTANCE_FACTOR, certify
from fpk.answer.dynamics import LARGEST_ERROR, NO_NOISE_YET, Transient
from fpk.answer.names import number_text
from fpk.numeric.arrays import SMALLEST, Array
from fpk.numeric.errors import NotApplicable, require
from fpk.solvers.line.time import transition
from fpk.solvers.line.time.elements import ChainDensity, Elements, Pair, Settings
from fpk.solvers.line.time.resolvent import matrices
from fpk.solvers.line.time.transition import Question, Source, Transition
from fpk.system.modulation import Modulation
from fpk.system.process import Process

STAGES = 5
"""Stages of a step of Radau IIA; its order is 2 · 5 − 1."""
FIRST_STEP = 1e-3
"""First step, over the first output time or kink of e(t): the diffusion forgets its error."""
STEP_RATIO = 3.0
"""Ratio of the times at end and start of a step at level 0, while steps grow with time."""
STEP_HALVINGS = (1, 4)
"""How often all steps are halved: while the mesh is adapted, and at most."""
Processes = Callable[[float], Process]
"""Function of a factor on the noise intensity that returns the process of the energy."""
Carried = tuple[ChainDensity, Array, Array]
"""The density at the output times, an array of numbers computed from it, and absolute errors of the
last of these numbers, as many as there are errors, that are not seen by refinement."""


def quiet_until(modulation: Modulation, source: Source) -> float:
    """Return the time until which the density that starts from ``source`` is constant.

    From rest that is the time at which noise begins, inf if it never does; otherwise it is 0.
    Raises ``InvalidInput`` for an energy > 0 if there is no noise at first: the energy decays.
    """
    if source.process is not None:
        return 0.0
    loud = np.flatnonzero(modulation.factor > 0.0)
    quiet = float(modulation.times[max(loud[0] - 1, 0)]) if loud.size else math.inf
    remedy = f"decays without noise until t = {quiet:g}; begin there, at rest or from noise=F"
    require(not quiet or not source.energy, "start", f"H={number_text(source.energy)}", remedy)
    return quiet


def radau_steps(
    e: Elements,
    load: Array,
    modulation: Modulation,
    unit: float,
    times: Array,
    *,
    level: int,
    absorbing: bool = False,
) -> tuple[ChainDensity, Array, Array, Array]:
    """Return the density at ``times`` > 0 that starts with ``load``, (elements, functions).

    ``times`` ascend; the noise intensity is ``modulation``² over ``unit`` times the noise of the
    elements ``e``. Also returned are the times of all stages, weights that integrate over time, and
    the mass, (steps · stages,) each. The steps of Radau IIA grow in proportion to time and end at
    the ``times`` and at the kinks of the modulation; all are halved ``level`` times. At the last
    end p = 0 if ``absorbing``, else the flux is zero.
    """
    # The points c_i, the last of which is 1, and the coefficients a_ij.
    x = np.append(roots_jacobi(STAGES - 1, 1, 0)[0], 1.0)
    A = legint(np.linalg.inv(legvander(x, STAGES - 1)), lbnd=-1.0)
    A, c, eye = 0.5 * legvander(x, STAGES) @ A, 0.5 * (1.0 + x), np.eye(STAGES)
    M, K, C, spread = matrices(e, absorbing=absorbing)
    root = np.exp(0.5 * e.log_scale)[:, None]
    begun, shares = (spread.T @ each.ravel() for each in (load / root, e.load * root))
    stops = np.unique(np.append(times, modulation.times[modulation.times < times[-1]]))
    stops = stops[stops > 0.0]
    first = FIRST_STEP * stops[0]
    count = np.ceil(np.log(stops[-1] / first) / np.log(STEP_RATIO))
    grown = first * STEP_RATIO ** np.arange(0.0, count)
    ends = [0.0]
    for stop in stops.tolist():
        inner = grown[(grown > ends[-1] * (1.0 + FIRST_STEP)) & (grown < stop * (1.0 - FIRST_STEP))]
        ends += [*inner.tolist(), stop]
    number, parts = np.arange(len(ends)), 2**level
    ends = np.interp(np.arange(number[-1] * parts + 1) / parts, number, ends)
    reached, residuals = [], []
    for before, step in zip(ends[:-1], np.diff(ends), strict=True):
        r = modulation(before + step * c) ** 2 / unit
        system = csc_array(kron(M, eye) + kron(K, step * A * r) - kron(C, step * A * (1.0 - r)))
        right = np.repeat(begun, STAGES)
        stages = splu(system).solve(right)
        size = float(np.max(abs(system) @ np.abs(stages)))
        missed = float(np.max(np.abs(system @ stages - right)))
        residuals.append(missed / size if size > 0.0 else missed)  # size 0: the density is 0
        reached.append(stages.reshape(-1, STAGES).T)
        begun = M @ reached[-1][-1]
    at_stages, lengths = np.array(reached), np.diff(ends)[:, None]
    last = at_stages[np.searchsorted(ends[1:], times), -1]
    values = root * (spread @ last.T).T.reshape(-1, *e.load.shape)
    density = ChainDensity(e, values, np.abs(values), float(np.max(residuals)))
    at, weights = ends[1:, None] - lengths * (1.0 - c), lengths * A[-1]
    return density, at.ravel(), weights.ravel(), (at_stages @ shares).ravel()


def halve_steps(
    question: Question,
    pair: Pair,
    carried: Callable[[Elements, int], Carried],
    size: Callable[[Array, Array], float],
    tol: float,
) -> tuple[Transition, list[Carried]]:
    """Halve all steps until the numbers of ``carried(elements, level)`` hardly change.

    That is ``DISTANCE_FACTOR`` · ``size(changes, numbers)`` <= ``tol``, or the last level of
    ``STEP_HALVINGS``. Returned are the density on adapted elements, started from ``pair``, and a
    list of three results of ``carried``: the answer, with steps twice as long, and with steps twice
    as long on the elements of a higher degree. If three levels or more were solved, the settings of
    the density contain the observed order of the steps.
    """
    carried = lru_cache(maxsize=4)(carried)
    solved = transition.solve_adaptively(
        question, pair, lambda e, **_: carried(e, STEP_HALVINGS[0])[0]
    )
    e, sizes = solved.elements, []
    for level in range(STEP_HALVINGS[0] + 1, STEP_HALVINGS[1] + 1):
        numbers = carried(e, level)[1]
        sizes.append(size(np.abs(numbers - carried(e, level - 1)[1]), numbers))
        if DISTANCE_FACTOR * sizes[-1] <= tol:
            break
    settings: Settings = {
        "equation": f"modulated noise, Radau IIA of order {2 * STAGES - 1}",
        "elements": e.count,
        "halvings of the steps": level,
        "tol": question.tol,
    }
    if len(sizes) > 1 and sizes[-1] > 0.0:
        settings["observed order"] = math.log2(sizes[-2] / sizes[-1])
    longer = carried(e, level - 1), carried(solved.enriched.elements, level - 1)
    return replace(solved, settings=settings), [carried(e, level), *longer]


def transition_with_modulation(
    under: Processes, modulation: Modulation, source: Source, times: Array, *, tol: float
) -> Transition:
    """Return the density at ascending ``times`` > 0 of an energy that starts from ``source``.

    At the factor e(t)² on the noise intensity, e the ``modulation``, the process is ``under(e²)``;
    ``tol`` is the L1 tolerance. The error is the distance to elements of a higher degree and to
    steps twice as long. Raises ``InvalidInput`` for times at which no noise has acted yet, and as
    ``quiet_until`` and ``pose_question`` do.
    """
    quiet = quiet_until(modulation, source)
    require(times[0] > quiet, "times", float(times[0]), NO_NOISE_YET)
    modulation, times = modulation.after(quiet), times - quiet
    unit = modulation.largest or 1.0
    first = float(modulation.energy(times[0])) / unit
    question, pair = transition.pose_question(under(unit), source, first, tol)

    def carried(e: Elements, level: int) -> Carried:
        g = radau_steps(e, source.load(e), modulation, unit, times, level=level)[0]
        return g, g.density(e.x.ravel())[0] * e.weight.ravel(), np.zeros(0)

    solved, found = halve_steps(
        question, pair, carried, lambda moved, _: float(moved.sum(axis=1).max()), 0.25 * tol
    )
    e, (own, _, enriched) = solved.elements, (each[0] for each in found)

    def apart(x: Array) -> Array:
        """|Change of p|, (times, points), at ``x`` by doubled steps, plus |change| by degree."""
        p, in_longer, in_both = (each[0].density(x)[0] for each in found)
        return np.asarray(np.abs(p - in_longer) + np.abs(in_longer - in_both))

    distance = apart(e.x.ravel()).reshape(-1, *e.x.shape)
    answer, _, _ = transition.estimate_error(question, own, enriched, distance=distance)
    # Without noise distances are largest at the ends of elements, which are no quadrature points.
    at_ends = apart(e.right)
    beside = np.maximum(at_ends, np.append(0.0 * at_ends[:, :1], at_ends[:, :-1], axis=1))
    distance = np.maximum(distance, beside[..., None])
    return replace(answer, distance=distance, settings={**answer.settings, **solved.settings})


def transient_with_modulation(
    under: Processes, modulation: Modulation, source: Source, times: Array, at: Array, *, tol: float
) -> Transient:
    """Return the densities of ``transition_with_modulation`` at ``times`` and energies ``at``.

    ``times`` > 0 ascend; ``tol`` is the L1 tolerance. If the modulation ends with 0, the motion
    dH/dt = F(H) leads from H_0 at its end to H at a later time, so that p(H, t) = p(H_0)
    F(H_0)/F(H). If the estimated error exceeds ``LARGEST_ERROR``, stated errors are infinite.
    Raises as ``transition_with_modulation`` does, and ``NotApplicable`` if damping feeds energy in
    and a time is later than the end of the noise.
    """
    end = float(modulation.times[-1]) if modulation.largest and not modulation.last else np.inf
    later = times > end
    stops = np.unique(np.minimum(times, end))
    solved = transition_with_modulation(under, modulation, source, stops, tol=tol)
    values, errors = np.zeros((2, times.size, at.size))
    values[~later], errors[~later] = (a[: int((~later).sum())] for a in solved.density(at))
    process, e, l1_error = under(1.0), solved.elements, solved.measured.l1_error
    inner, last = e.x.ravel(), e.right[-1]
    H, positive = process.on_mesh(at, float(np.max(at, initial=last)))

    def rate(_: float, z: Array) -> Array:
        # −dz/dt of z = ln H, constant beyond the last element, where p is 0.
        energy = np.exp(np.minimum(z, np.log(last)))
        return np.asarray(-process.coefficients(energy).dissipation / energy)

    if np.any(later) and np.any(process.coefficients(inner).dissipation >= 0.0):
        raise NotApplicable("damping feeds energy in: after the end of the noise fem has no answer")
    for k in np.flatnonzero(later):
        time, z = float(times[k] - end), np.log(H)
        # The answer, and a solution of lower accuracy whose distance is its error.
        solved_to = partial(solve_ivp, rate, (0.0, time), z, method="DOP853")
        end_z, rough = (solved_to(rtol=eps, atol=eps).y[:, -1] for eps in (1e-12, 1e-10))
        began = np.exp(end_z)
        jacobian = began * rate(0.0, end_z) / (H * rate(0.0, z))
        inside = np.minimum(began, last)
        # An error of F by ε shifts ln H_0 by ε F/H t.
        relative = float(e.relative_error.max())
        fastest = float(np.max(rate(0.0, np.log(inner))))
        moved = float(np.max(np.abs(end_z - rough), initial=0.0)) + relative * fastest * time
        p, error = (a[-1] for a in solved.density(began))
        shifted = solved.density(np.minimum(inside * np.exp(moved), last))[0][-1]
        changed = np.abs(shifted - p) * (began <= last) + (moved + 2.0 * relative) * np.abs(p)
        # Beyond the last element p falls faster than 1/H.
        lost = jacobian * (error * inside / began + DISTANCE_FACTOR * changed)
        values[k] = np.where(positive, jacobian * p, 0.0)
        errors[k] = np.where(at >= 0.0, lost + SMALLEST, 0.0)
        # A shift of ln H by ``moved`` changes p by at most its total variation, of two maxima.
        height = float(np.max(np.abs(solved.solution.density(inner)[0][-1]) * inner))
        own = solved.measured.l1_error + 4.0 * DISTANCE_FACTOR * moved * height + 2.0 * relative
        l1_error = float(np.max([l1_error, own]))
    if not l1_error <= LARGEST_ERROR:
        errors[:] = np.inf
    certificate = certify(replace(solved.measured, l1_error=l1_error), tol=tol)
    return Transient(times, values, errors, "numerical", certificate, solved.settings)
