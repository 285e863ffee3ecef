"""Densities of one energy at times after a start, from its transition density."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fpk.answer.certificate import DISTANCE_FACTOR, Certificate, Measured, certify
from fpk.answer.names import number_text
from fpk.numeric.arrays import EPS, ROUNDINGS, SMALLEST, Array, Flags
from fpk.numeric.errors import InvalidInput
from fpk.solvers.line import mesh
from fpk.solvers.line.elements import ENRICHMENT
from fpk.solvers.line.time import elements as chain
from fpk.solvers.line.time.elements import ChainDensity, Elements, Pair, Settings
from fpk.solvers.line.time.resolvent import inverse_laplace
from fpk.system.process import Process

MIN_LOG_SHARE = -600.0
"""Smallest ln(p H) of the stationary density at a start energy, less its maximum, that is accepted;
four times as much if the start is a density (at −5000 errors exceed the stated errors)."""


@dataclass(frozen=True, eq=False)
class Source:
    """Initial density: at one ``energy``, or the stationary density of another ``process`` if it is
    not None."""

    energy: float = 0.0
    process: Process | None = None

    @cached_property
    def extent(self) -> float:
        """Energy above which the mass of the source is below round-off; ``energy`` for a point."""
        return float(mesh.probe_process(self.process).extent(EPS)) if self.process else self.energy

    def nodes(self, end: float, degree: int) -> Array:
        """Return nodes of elements of ``degree``, up to ``end``, that resolve a source density;
        empty for one energy. Above the extent of the source elements grow by ``LENGTH_RATIO``."""
        if self.process is None:
            return np.zeros(0)
        last = min(end, self.extent)
        steps = np.arange(1.0, np.log(end / last) / np.log(mesh.LENGTH_RATIO))
        return np.append(
            mesh.time_nodes(self.process, last, degree), last * mesh.LENGTH_RATIO**steps
        )

    def samples(self, e: Elements) -> tuple[Array, Array]:
        """Return energies and weights, (points,) each: Σ weight f(energy) is the mean of f over the
        source. A source density counts within the elements ``e`` only."""
        if self.process is None:
            return np.array([self.energy]), np.ones(1)
        nodes = mesh.time_nodes(self.process, self.extent, mesh.MAX_ELEMENT_DEGREE)
        own = chain.chain_elements(self.process, nodes[:-1], nodes[1:], mesh.MAX_ELEMENT_DEGREE)
        within = e.x < self.extent
        x = e.x[within]
        log_p = own.log_density(x) - np.logaddexp.reduce(own.log_mass)
        return x, e.weight[within] * np.exp(log_p)

    def load(self, e: Elements) -> Array:
        """Return E f_i over the source within ``e``, for the functions f_i of each element:
        (elements, functions)."""
        x, weights = self.samples(e)
        k, values = e.functions(x)
        load = np.zeros(e.load.shape)
        np.add.at(load, k, weights[:, None] * values)
        return load


@dataclass(frozen=True)
class Question:
    """Start from ``source``, width of p at the first time (an energy; from a density the energy
    scale of the process), and L1 tolerance ``tol``."""

    source: Source
    width: float
    tol: float

    def common_error(self, e: Elements, p: Array, size: Array, x: Array) -> Array:
        """Return the absolute errors of ``p`` (times, points) at ``x`` that no mesh shows.

        They are errors by the coefficients, amplified where p is small, as at short times
        ln p ~ −(distance)²/(2 b t); and round-off of energies and of the terms of p, whose sizes
        have the sum ``size`` (times, points).
        """
        rounding = ROUNDINGS * EPS * (1.0 + x / self.width + e.log_range)
        top = np.abs(p).max(axis=1, keepdims=True) + SMALLEST
        steep = 2.0 + np.log(top) - np.log(np.clip(np.abs(p), SMALLEST, top))
        coefficients = 2.0 * e.coefficient_error(self.source.energy) * steep
        coefficients += e.relative_error[e.within(x)[0]]
        return np.asarray((coefficients + rounding) * np.abs(p) + ROUNDINGS * EPS * size)


@dataclass(frozen=True, eq=False)
class Transition:
    """Density of an energy at several times after a start, with its error and certificate.

    ``distance`` (times, elements, points) is the distance of p to more accurate solutions, ``top``
    (times,) the largest p.
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
        """Elements of the answer."""
        return self.solution.elements

    @property
    def certificate(self) -> Certificate:
        """Certificate for the tolerance of the question."""
        return certify(self.measured, tol=self.question.tol)

    def density(self, x: Array) -> tuple[Array, Array]:
        """Return p and its error at energies ``x`` (points,): two arrays (times, points). Below 0
        both are 0; beyond the last element p is 0, with an error of at least p at the end."""
        e = self.elements
        end = float(e.right[-1])
        inside, positive = e.process.on_mesh(x, end)
        p, size = self.solution.density(inside)
        error = DISTANCE_FACTOR * self.distance.max(axis=2)[:, e.within(inside)[0]]
        error = error + self.question.common_error(e, p, size, inside)
        # Far from the peak p is a difference of larger numbers.
        error += ROUNDINGS * EPS * self.top[:, None]
        error = np.where(x > end, error + np.abs(p), error)
        return np.where(positive, p, 0.0), np.where(x >= 0.0, error + SMALLEST, 0.0)


def transition(process: Process, source: Source, times: Array, *, tol: float = 1e-10) -> Transition:
    """Return the density of the energy of ``process`` at ``times`` > 0 after a start from
    ``source``, to the L1 tolerance ``tol``. Raises as ``pose_question`` does."""
    question, pair = pose_question(process, source, float(times.min()), tol)
    return solve_adaptively(
        question, pair, lambda e, more: inverse_laplace(e, source.load(e), times, more=more)
    )


def pose_question(
    process: Process, source: Source, time: float, tol: float, *, limit: float | None = None
) -> tuple[Question, Pair]:
    """Return the question of ``process`` from ``source``, and its first pair of elements.

    ``time`` is the first time, ``tol`` the L1 tolerance. Meshes end at the absorbing ``limit``, or
    where the mass beyond is ``TAIL_SHARES`` · tol at any time: from a start at H_0 it is less than
    the stationary mass beyond, over the stationary mass beyond H_0. Raises as
    ``probe_process`` does, and ``InvalidInput``, if there is no ``limit``, for a start beyond the
    range of double precision.
    """
    degree, start, width, fine = chain.degree_for(tol), source.energy, process.energy_scale, []
    if source.process is None:
        # √(b t), or b' t near H = 0, where b ~ H.
        c = process.coefficients(np.array([max(start, 1e-9 * width)]))
        spread = math.sqrt(float(c.diffusion[0]) * time) if start > 0.0 else 0.0
        width = max(spread, 0.5 * float(c.divergence[0]) * time)
        fine.append((start, mesh.LAYER * width))
    if limit is not None:
        fine.append(mesh.layer_at(process, limit, time))
        nodes = mesh.time_nodes(process, limit, degree, fine=fine, more=source.nodes(limit, degree))
        return Question(source, width, tol), chain.element_pair(process, nodes, degree)
    probe, share = mesh.probe_process(process), 0.0
    top = int(probe.log_mass.argmax())
    if source.extent > probe.energy[top]:
        above = np.interp(np.log(source.extent), np.log(probe.energy), probe.log_mass)
        share = float(above - probe.log_mass[top])
    if share < MIN_LOG_SHARE * (1.0 if source.process is None else 4.0):
        remedy = "the stationary probability beyond it is out of the range of double precision"
        raise InvalidInput("start", f"H={number_text(start or source.extent)}", remedy)
    tails = [tail * tol for tail in chain.TAIL_SHARES]
    if source.process is None:
        end, last = (max(probe.extent(x * math.exp(share)), 1.05 * start) for x in tails)
    else:
        both = probe, mesh.probe_process(source.process)
        end, last = (max(each.extent(x) for each in both) for x in tails)
    last = max(last, 1.02 * end)  # the mesh of the enriched solution is longer by 2 % at least
    nodes = mesh.time_nodes(process, end, degree, fine=fine, more=source.nodes(end, degree))
    beyond = np.linspace(end, last, 1 + math.ceil((last - end) / float(nodes[-1] - nodes[-2])))
    return Question(source, width, tol), chain.element_pair(
        process, nodes, degree, beyond=beyond[1:]
    )


def solve_adaptively(
    question: Question, pair: Pair, solve: Callable[..., ChainDensity]
) -> Transition:
    """Return the transition by ``solve(e=elements, more=points)`` on adapted meshes. ``pair`` is
    the first mesh; ``more``, > 0 for the enriched solution, adds points to the ``contours``."""
    before, tol = math.inf, question.tol

    def solved(pair: Pair) -> tuple[Transition, Flags]:
        nonlocal before
        solutions = solve(e=pair[0], more=0), solve(e=pair[1], more=ENRICHMENT)
        answer, own, rounding = estimate_error(question, *solutions)
        marked = own > np.maximum(0.1 * tol / own.size, rounding)
        small = DISTANCE_FACTOR * own.sum() <= 0.5 * tol or not own.sum() < before
        before = own.sum()
        return answer, marked & (not small)

    return chain.solve_with_refinement(pair, solved)


def estimate_error(
    question: Question, own: ChainDensity, finer: ChainDensity, *, distance: Array | None = None
) -> tuple[Transition, Array, Array]:
    """Return the transition of the solution ``own`` with its error, and the errors by elements.

    ``distance`` (times, elements, points) is |p − p of a better solution| at the Gauss points of
    ``own``, by default of the enriched solution ``finer``. The last two arrays (elements,) are the
    integrals over each element of ``distance`` and of ``common_error`` of the ``question``, each
    the largest of all times.
    """
    answer, enriched = own.elements, finer.elements
    x, w = answer.x, answer.weight
    (p, size), (better, other) = (f.density(x.ravel()) for f in (own, finer))
    shape = (len(p), *x.shape)
    distance = np.abs(p - better).reshape(shape) if distance is None else distance
    last = float(enriched.right[-1])
    # Mass of the enriched solution beyond the last element of the answer.
    far, far_w = enriched.x[answer.count :], enriched.weight[answer.count :]
    beyond = np.abs(finer.density(np.append(far.ravel(), last))[0])
    tail = (beyond[:, :-1] @ far_w.ravel()).max()
    tail += mesh.probe_process(answer.process).tail_bound(last, float(beyond[:, -1].max()))
    common = question.common_error(answer, p, size + other, x.ravel())
    pointwise = DISTANCE_FACTOR * distance.reshape(p.shape) + common
    common = common.reshape(shape) * w
    top, errors = p.max(axis=1), ((DISTANCE_FACTOR * distance * w) + common).sum(axis=(1, 2))
    measured = Measured(
        l1_error=float(errors.max() + 2.0 * tail),
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
