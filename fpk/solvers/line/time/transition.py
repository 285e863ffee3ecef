"""Densities of one energy at times after a start, from its transition density."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fpk.answer.certificate import Certificate, Measured, certify
from fpk.answer.names import number_text
from fpk.numeric.arrays import EPS, ROUNDINGS, SMALLEST, Array, Flags
from fpk.numeric.errors import InvalidInput
from fpk.solvers.line.elements import ENRICHMENT
from fpk.solvers.line.mesh import (
    LAYER,
    LENGTH_RATIO,
    MAX_ELEMENT_DEGREE,
    layer_at,
    probe_process,
    time_nodes,
)
from fpk.solvers.line.time.elements import (
    SAFETY,
    TAIL_SHARES,
    ChainDensity,
    Elements,
    Pair,
    Settings,
    chain_elements,
    degree_for,
    element_pair,
    solve_with_refinement,
)
from fpk.solvers.line.time.resolvent import inverse_laplace
from fpk.system.process import Process

MIN_LOG_SHARE = -600.0
"""ln of the least stationary probability beyond a start that double precision can relate to one;
four times as much where the start is a density and not one energy (at −5000 errors exceed it)."""


@dataclass(frozen=True, eq=False)
class Source:
    """Initial density of a transient: at one energy, or the stationary one of another process."""

    energy: float = 0.0
    process: Process | None = None

    @cached_property
    def extent(self) -> float:
        """Energy above which no more than the round-off of the source is."""
        return (
            self.energy if self.process is None else float(probe_process(self.process).extent(EPS))
        )

    def nodes(self, end: float, degree: int) -> Array:
        """Return ends of elements that see the source; beyond it they grow up to ``end``."""
        if self.process is None:
            return np.zeros(0)
        last = min(end, self.extent)
        steps = np.arange(1.0, np.log(end / last) / np.log(LENGTH_RATIO))
        return np.append(time_nodes(self.process, last, degree), last * LENGTH_RATIO**steps)

    def samples(self, e: Elements) -> tuple[Array, Array]:
        """Return energies within the elements, and their weights in a mean over the source."""
        if self.process is None:
            return np.array([self.energy]), np.ones(1)
        nodes = time_nodes(self.process, self.extent, MAX_ELEMENT_DEGREE)
        own = chain_elements(self.process, nodes[:-1], nodes[1:], MAX_ELEMENT_DEGREE)
        within = e.x < self.extent
        x = e.x[within]
        log_p = own.log_density(x) - np.logaddexp.reduce(own.log_mass)
        return x, e.weight[within] * np.exp(log_p)

    def load(self, e: Elements) -> Array:
        """Return its moments with the functions of each element, (elements, functions)."""
        x, weights = self.samples(e)
        k, values = e.functions(x)
        load = np.zeros(e.load.shape)
        np.add.at(load, k, weights[:, None] * values)
        return load


@dataclass(frozen=True)
class Question:
    """A density from ``source``, ``width`` wide at the first time, to the L1 tolerance ``tol``."""

    source: Source
    width: float
    tol: float

    def common_error(self, e: Elements, p: Array, size: Array, x: Array) -> Array:
        """Return errors that the densities ``p`` at x have in common on any elements.

        By the coefficients: at short times ln p ~ −(distance)²/(2 b t), so that they count the more
        the smaller p is. By the rounding of energies, and of terms of ``size`` that cancel.
        """
        rounding = ROUNDINGS * EPS * (1.0 + x / self.width + e.log_range)
        top = np.abs(p).max(axis=1, keepdims=True) + SMALLEST
        steep = 2.0 + np.log(top) - np.log(np.clip(np.abs(p), SMALLEST, top))
        coefficients = 2.0 * e.coefficient_error(self.source.energy) * steep
        coefficients += e.relative_error[e.within(x)[0]]
        return np.asarray((coefficients + rounding) * np.abs(p) + ROUNDINGS * EPS * size)


@dataclass(frozen=True, eq=False)
class Transition:
    """The density of an energy at several times after a start, with its error and certificate.

    ``distance`` (times, elements, points) to more accurate solutions, ``top`` (times,) largest p.
    """

    question: Question
    solution: ChainDensity
    enriched: ChainDensity
    distance: Array
    top: Array
    measured: Measured
    settings: Settings

    @property
    def elements(self) -> Elements:
        """The elements of the answer."""
        return self.solution.elements

    @property
    def certificate(self) -> Certificate:
        """The certificate by the tolerance that was asked for."""
        return certify(self.measured, tol=self.question.tol)

    def density(self, x: Array) -> tuple[Array, Array]:
        """Return p and its error at energies x (points,): two arrays (times, points).

        Below 0 both are 0; beyond the last element p is 0 and the error what it is at the end.
        """
        e = self.elements
        end = float(e.right[-1])
        inside, positive = e.process.on_mesh(x, end)
        p, size = self.solution.density(inside)
        error = SAFETY * self.distance.max(axis=2)[:, e.within(inside)[0]]
        error = error + self.question.common_error(e, p, size, inside)
        # Far from the peak p is a difference of larger numbers.
        error += ROUNDINGS * EPS * self.top[:, None]
        error = np.where(x > end, error + np.abs(p), error)
        return np.where(positive, p, 0.0), np.where(x >= 0.0, error + SMALLEST, 0.0)


def transition(process: Process, source: Source, times: Array, *, tol: float = 1e-10) -> Transition:
    """Return the density at ``times`` > 0 after ``source``, to ``tol`` if certified."""
    question, pair = pose_question(process, source, float(times.min()), tol)
    return solve_adaptively(
        question, pair, lambda e, more: inverse_laplace(e, source.load(e), times, more=more)
    )


def pose_question(
    process: Process, source: Source, time: float, tol: float, *, limit: float | None = None
) -> tuple[Question, Pair]:
    """Return the question, ``time`` the first one asked for, and the meshes to begin with.

    Without an absorbing ``limit`` no more than ``TAIL_SHARES`` is beyond them at any time: from a
    start above the energy H_0 it is less than the stationary tail over that beyond H_0. Raises
    ``InvalidInput`` for a start beyond the range of double precision.
    """
    degree, start, width, fine = degree_for(tol), source.energy, process.energy_scale, []
    if source.process is None:
        # √(b t), b ~ H at H = 0, where b' is wanted beside it.
        c = process.coefficients(np.array([max(start, 1e-9 * width)]))
        spread = math.sqrt(float(c.diffusion[0]) * time) if start > 0.0 else 0.0
        width = max(spread, 0.5 * float(c.divergence[0]) * time)
        fine.append((start, LAYER * width))
    if limit is not None:
        fine.append(layer_at(process, limit, time))
        nodes = time_nodes(process, limit, degree, fine=fine, more=source.nodes(limit, degree))
        return Question(source, width, tol), element_pair(process, nodes, degree)
    probe, share = probe_process(process), 0.0
    top, least = (
        int(probe.log_mass.argmax()),
        MIN_LOG_SHARE * (1.0 if source.process is None else 4.0),
    )
    if source.extent > probe.energy[top]:
        above = np.interp(np.log(source.extent), np.log(probe.energy), probe.log_mass)
        share = float(above - probe.log_mass[top])
    if share < least:
        remedy = "the stationary probability beyond it is out of the range of double precision"
        raise InvalidInput("start", f"H={number_text(start or source.extent)}", remedy)
    ends = []
    for tail in TAIL_SHARES:
        if source.process is None:
            ends.append(max(probe.extent(math.exp(math.log(tail * tol) + share)), 1.05 * start))
        else:
            ends.append(
                max(each.extent(tail * tol) for each in (probe, probe_process(source.process)))
            )
    # The enriched solution reaches farther, by a fiftieth at least.
    end, last = ends[0], max(ends[1], 1.02 * ends[0])
    nodes = time_nodes(process, end, degree, fine=fine, more=source.nodes(end, degree))
    beyond = np.linspace(end, last, 1 + math.ceil((last - end) / float(nodes[-1] - nodes[-2])))
    return Question(source, width, tol), element_pair(process, nodes, degree, beyond=beyond[1:])


def solve_adaptively(
    question: Question, pair: Pair, solve: Callable[..., ChainDensity]
) -> Transition:
    """Return what ``solve(e=elements, more=degrees)`` gives on meshes that adapt, judged."""
    before, tol = math.inf, question.tol

    def solved(pair: Pair) -> tuple[Transition, Flags]:
        nonlocal before
        solutions = solve(e=pair[0], more=0), solve(e=pair[1], more=ENRICHMENT)
        answer, own, rounding = estimate_error(question, *solutions)
        marked = own > np.maximum(0.1 * tol / own.size, rounding)
        small = SAFETY * own.sum() <= 0.5 * tol or not own.sum() < before
        before = own.sum()
        return answer, marked & (not small)

    return solve_with_refinement(pair, solved)


def estimate_error(
    question: Question, own: ChainDensity, finer: ChainDensity, *, distance: Array | None = None
) -> tuple[Transition, Array, Array]:
    """Return the solution, judged by its ``distance``, to the enriched one ``finer`` unless given.

    Then each element's part of the error, and of its round-off.
    """
    answer, enriched = own.elements, finer.elements
    x, w = answer.x, answer.weight
    (p, size), (better, other) = (f.density(x.ravel()) for f in (own, finer))
    shape = (len(p), *x.shape)
    distance = np.abs(p - better).reshape(shape) if distance is None else distance
    last = float(enriched.right[-1])
    # What the enriched solution has beyond the last element of the answer.
    far, far_w = enriched.x[answer.count :], enriched.weight[answer.count :]
    beyond = np.abs(finer.density(np.append(far.ravel(), last))[0])
    tail = (beyond[:, :-1] @ far_w.ravel()).max()
    tail += probe_process(answer.process).tail_bound(last, float(beyond[:, -1].max()))
    common = question.common_error(answer, p, size + other, x.ravel())
    pointwise = SAFETY * distance.reshape(p.shape) + common
    common = common.reshape(shape) * w
    top = p.max(axis=1)
    measured = Measured(
        l1_error=float(((SAFETY * distance * w) + common).sum(axis=(1, 2)).max() + 2.0 * tail),
        mass_defect=float(np.abs(p @ w.ravel() - 1.0).max()),
        minimum=float((p.min(axis=1) / top).min()),
        residual=own.residual,
        tail_mass=float(tail),
        absolute_error=float((pointwise.max(axis=1) / top).max()),
    )
    settings: Settings = {
        "degree": answer.degree, "elements": answer.count, "last energy": float(answer.right[-1]),
        "tol": question.tol,
    }  # fmt: skip
    solved = Transition(question, own, finer, distance, top, measured, settings)
    return solved, (distance * w).sum(axis=2).max(axis=0), common.sum(axis=2).max(axis=0)
