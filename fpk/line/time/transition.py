"""Densities of one energy at times after a start, from its transition density."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from fpk.arrays import EPS, SMALLEST, Array
from fpk.certificate import Certificate, Measured, certify
from fpk.errors import InvalidInput
from fpk.line.time.elements import (
    ENRICHMENT,
    MOST_ROUNDS,
    Elements,
    Pair,
    cut,
    degree_for,
    meshed,
)
from fpk.line.time.mesh import LAYER, NONE, layer_at, time_nodes
from fpk.line.time.propagation import Solution, Source, propagated
from fpk.observable import number_text
from fpk.probe import Probe, probed
from fpk.process import Process

SAFETY = 3.0
"""Factor on the distance to the enriched solution."""
ROUND_OFF = 8.0
"""Roundings of the terms that cancel in the rule of the inverse transform."""
TAIL = (1e-3, 1e-8)
"""Share of the tolerance that may lie beyond the mesh: of the answer, and of the enriched one."""
NEAR_ZERO = 1e-9
"""Energy, in units of the scale, that stands for H = 0 where b' is wanted there."""
LENGTHENED = 1.02
"""Least ratio of the last energy of the enriched solution to that of the answer."""
FARTHEST = -600.0
"""ln of the least stationary probability beyond a start that double precision can relate to one."""
FARTHEST_EXTENT = 4.0 * FARTHEST
"""ln of the least stationary probability where the start is a density and not one energy; at −5000
errors exceed the answer."""
MOST_ELEMENTS = 1_000
"""Elements beyond which none is cut."""
STALLED = 0.9
"""Ratio of the error to that of the round before that shows that finer elements do not help."""
CHECKED_TIMES = 6
"""Times at which the mesh is adapted first, then at all."""
Settings = dict[str, str | float | int]


@dataclass(frozen=True)
class Question:
    """A density that begins with ``source``, as it is at certain times and to ``tol`` in L1.

    ``width`` is that of the density at the first of the times.
    """

    process: Process
    source: Source
    width: float
    tol: float


@dataclass(frozen=True, eq=False)
class Transition:
    """The density of an energy at several times after a start, with its error and certificate.

    ``distance`` (times, elements, points) is that to more accurate solutions at the ``points`` of
    the elements, ``top`` (times,) the largest density there.
    """

    question: Question
    solution: Solution
    enriched: Solution
    distance: Array
    top: Array
    measured: Measured
    certificate: Certificate
    settings: Settings

    @property
    def elements(self) -> Elements:
        """The elements of the answer."""
        return self.solution.elements

    @property
    def pair(self) -> Pair:
        """The elements of the answer and of the enriched solution."""
        return self.solution.elements, self.enriched.elements

    def density(self, x: Array) -> tuple[Array, Array]:
        """Return p and its error at energies x (points,): two arrays (times, points).

        Below 0 both are 0; beyond the last element p is 0 and the error what it is at the end.
        """
        e = self.elements
        end = float(e.right[-1])
        inside, positive = self.question.process.on_mesh(x, end)
        p, size = self.solution.density(inside)
        error = SAFETY * self.distance.max(axis=2)[:, e.element_of(inside)]
        error = error + common_error(self.question, e, p, size, inside)
        # What is left of larger numbers far from the peak.
        error += ROUND_OFF * EPS * self.top[:, None]
        error = np.where(x > end, error + np.abs(p), error)
        return np.where(positive, p, 0.0), np.where(x >= 0.0, error + SMALLEST, 0.0)


def transition(process: Process, source: Source, times: Array, *, tol: float = 1e-10) -> Transition:
    """Return the density at ``times`` > 0 after ``source``, to the L1 tolerance ``tol``.

    The mesh adapts, fine at the start; what is not met is said in the certificate. Raises
    ``InvalidInput`` for a start beyond the range of double precision.
    """
    question, pair = posed(process, source, float(times.min()), tol)
    few = np.unique(np.linspace(0, times.size - 1, CHECKED_TIMES).astype(int))
    for chosen in (times[few], times) if few.size < times.size else (times,):
        solve = partial(propagated, process, source=source, times=chosen)
        solved = adapted(question, pair, solve)
        pair = solved.pair
    return solved


def posed(
    process: Process, source: Source, time: float, tol: float, *, limit: float | None = None
) -> tuple[Question, Pair]:
    """Return the question, ``time`` the first one asked for, and the meshes to begin with.

    Those of the answer and of the enriched solution, which reaches farther where there is no
    absorbing ``limit``. Raises ``InvalidInput`` for a start beyond the range of double precision.
    """
    degree, start = degree_for(tol), source.energy
    width, fine, beyond = process.energy_scale, [], NONE
    if source.process is None:
        width = width_of(process, start, time)
        fine.append((start, LAYER * width))
    if limit is not None:
        fine.append(layer_at(process, limit, time))
        end = limit
    else:
        end, last = _ends(process, source, tol)
    nodes = time_nodes(process, end, degree, fine=tuple(fine), more=source.nodes(end, degree))
    if limit is None:
        length = float(nodes[-1] - nodes[-2])
        beyond = np.linspace(end, last, 1 + max(1, math.ceil((last - end) / length)))[1:]
    pair = meshed(process, nodes, degree, beyond=beyond)
    return Question(process, source, width, tol), pair


def adapted(question: Question, pair: Pair, solve: Callable[..., Solution]) -> Transition:
    """Return what ``solve(elements, more=0)`` gives on meshes cut where they have to be, judged.

    For the enriched solution ``more`` is ``ENRICHMENT``.
    """
    before, tol, process = math.inf, question.tol, question.process
    for _ in range(MOST_ROUNDS):
        solutions = solve(pair[0], more=0), solve(pair[1], more=ENRICHMENT)
        solved, own, rounding = judged(question, *solutions)
        marked = own > np.maximum(0.1 * tol / own.size, rounding)
        small = SAFETY * own.sum() <= 0.5 * tol or not own.sum() < STALLED * before
        if small or not marked.any() or marked.size > MOST_ELEMENTS:
            break
        before = own.sum()
        pair = cut(process, pair, marked)
    return solved


def width_of(process: Process, start: float, time: float) -> float:
    """Width of the density at a short ``time`` after an energy: √(b t), b ~ H at H = 0."""
    c = process.coefficients(np.array([max(start, NEAR_ZERO * process.energy_scale)]))
    spread = math.sqrt(float(c.diffusion[0]) * time) if start > 0.0 else 0.0
    return max(spread, 0.5 * float(c.divergence[0]) * time)


def judged(
    question: Question, own: Solution, finer: Solution, *, distance: Array | None = None
) -> tuple[Transition, Array, Array]:
    """Return the solution, judged, each element's part of its error, and of its round-off.

    ``distance`` as of ``Transition``; left out, it is that to the enriched solution ``finer``.
    """
    answer, enriched = own.elements, finer.elements
    x, w = answer.x, answer.weight
    p, size = own.density(x.ravel())
    shape = (len(p), *x.shape)
    if distance is None:
        better, other = finer.density(x.ravel())
        distance, size = np.abs(p - better).reshape(shape), size + other
    last = float(enriched.right[-1])
    # What the enriched solution has beyond the last element of the answer.
    far, far_w = enriched.x[answer.count :], enriched.weight[answer.count :]
    beyond = np.abs(finer.density(np.append(far.ravel(), last))[0])
    tail = (beyond[:, :-1] @ far_w.ravel()).max()
    tail += probed(question.process).tail_bound(last, float(beyond[:, -1].max()))
    common = common_error(question, answer, p, size, x.ravel())
    pointwise = SAFETY * distance.reshape(p.shape) + common
    common = common.reshape(shape) * w
    top = p.max(axis=1)
    measured = Measured(
        l1_error=float(((SAFETY * distance * w) + common).sum(axis=(1, 2)).max() + 2.0 * tail),
        mass_defect=float(np.abs(p @ w.ravel() - 1.0).max()),
        minimum=float((p.min(axis=1) / top).min()),
        residual=own.g.residual,
        tail_mass=float(tail),
        absolute_error=float((pointwise.max(axis=1) / top).max()),
    )
    certificate = certify(measured, tol=question.tol)
    settings: Settings = {
        "degree": answer.degree, "elements": answer.count, "last energy": float(answer.right[-1]),
        "tol": question.tol,
    }  # fmt: skip
    solved = Transition(question, own, finer, distance, top, measured, certificate, settings)
    each = (distance * w).sum(axis=2).max(axis=0)
    return solved, each, common.sum(axis=2).max(axis=0)


def _log_share_above(probe: Probe, energy: float) -> float:
    """About ln of the stationary probability above ``energy``."""
    if energy <= 0.0:
        return 0.0
    top = int(probe.log_mass.argmax())
    at = np.interp(np.log(energy), np.log(probe.energy), probe.log_mass)
    return float(min(at - probe.log_mass[top], 0.0)) if energy > probe.energy[top] else 0.0


def _ends(process: Process, source: Source, tol: float) -> tuple[float, float]:
    """Return energies above which no more than ``TAIL`` is at any time after the start.

    From a start in the stationary state beyond the energy H_0 it is not more, at any energy, than
    the stationary tail over that beyond H_0; and from H_0 itself still less.
    """
    probe, start = probed(process), source.energy
    log_share = _log_share_above(probe, start)
    if log_share < FARTHEST or _log_share_above(probe, source.extent) < FARTHEST_EXTENT:
        remedy = "the stationary probability beyond it is out of the range of double precision"
        raise InvalidInput("start", f"H={number_text(start or source.extent)}", remedy)
    ends = []
    for tail in TAIL:
        end = probe.extent(math.exp(math.log(tail * tol) + log_share))
        if source.process is not None:
            end = max(end, probed(source.process).extent(tail * tol))
        ends.append(max(end, 1.05 * start))
    return ends[0], max(ends[1], LENGTHENED * ends[0])


def common_error(question: Question, e: Elements, p: Array, size: Array, x: Array) -> Array:
    """Errors that the answer and the enriched solution have in common.

    By the coefficients: at short times ln p ~ −(distance)²/(2 b t), so that they count the more
    the smaller p is. By the rounding of energies: p changes over the width of the density at
    the first time. By what cancels in p, of which ``size`` is that of the terms.
    """
    rounding = ROUND_OFF * EPS * (1.0 + x / question.width + float(np.ptp(e.log_scale)))
    top = np.abs(p).max(axis=1, keepdims=True) + SMALLEST
    steep = 2.0 + np.log(top) - np.log(np.clip(np.abs(p), SMALLEST, top))
    floor = ROUND_OFF * EPS * size
    coefficients = 2.0 * e.coefficient_error(question.source.energy) * steep
    coefficients += e.relative_error[e.element_of(x)]
    return np.asarray((coefficients + rounding) * np.abs(p) + floor)
