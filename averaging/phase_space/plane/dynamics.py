"""Solutions of one mass on uniformly finer meshes for questions in time, and their generators."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.sparse import csc_array
from threadpoolctl import threadpool_limits

from averaging.phase_space.dynamics import elimination_cost
from averaging.phase_space.equation.elimination import Solve, Step
from averaging.phase_space.marginals import moments
from averaging.phase_space.plane.elements import Elements, assemble_backward, factorise_sparse
from averaging.phase_space.plane.mesh import Mesh
from averaging.phase_space.plane.oscillator import Oscillator, rarest_energy
from averaging.phase_space.plane.stationary import (
    BYTES,
    OPERATIONS,
    OUTFLOW,
    PlaneState,
    stationary_state,
    uniform_solutions,
)
from averaging.phase_space.refinement import Ladder, Options, ladder_of
from averaging.phase_space.resolvent import Generator, generators, without_mass
from fpk.answer.names import Observable
from fpk.numeric.arrays import Array
from fpk.numeric.machine import usable_cores

PANELS, FINER = 3, 0.75
"""Panels between rest and the largest speed on the first mesh; ratio of the lengths of panels of
successive meshes: the largest by which three become four."""
KICKS = 8.0
"""Largest panel of the first mesh over the velocity change by noise in half a period: with 16, at a
damping ratio of 0.0025, an error of a spectrum was 20 times the stated one, on the next meshes 0.5
times."""


def uniform_ladder(
    o: Oscillator, observables: Sequence[Observable], options: Options
) -> Iterator[Ladder]:
    """Yield ladders of ``uniform_solutions``; the last is yielded again with its ``limit``.

    Energies end where so little passes that no answer feels it.
    """

    def solved(mesh: Mesh) -> tuple[PlaneState, bool]:
        e = stationary_state(mesh)
        return e, abs(e.outflow) > OUTFLOW * o.frequency

    top = rarest_energy(o)
    swift, reach = np.sqrt(2.0 * top / o.mass), o.turning_point(top, 1.0)
    panel = min(1.0 / PANELS, KICKS * o.kick(reach) / swift)
    ladder: Ladder | None = None
    with threadpool_limits(limits=options.threads or usable_cores(), user_api="blas"):
        solutions = uniform_solutions(o, top, (panel, FINER), solved, options)
        for (coarser, _), (finest, limit) in pairwise(solutions):
            ladder = ladder_of(finest, coarser, observables, ladder)
            yield ladder
            if limit:
                yield replace(ladder, limit=limit)


@moments.register
def _(e: PlaneState) -> tuple[Array, Array]:
    def mean(i: int, j: int) -> float:
        return e.mean(lambda q, v: q**i * v**j)

    m, first = e.mesh.oscillator.mass, np.array([mean(1, 0), mean(0, 1)])
    second = np.array([[mean(2, 0), mean(1, 1)], [mean(1, 1), mean(0, 2)]])
    return np.sqrt(m) * first, m * (second - np.outer(first, first))


@elimination_cost.register
def _(e: PlaneState, numbers: type) -> tuple[float, float]:
    words = np.dtype(numbers).itemsize / 8
    return BYTES * words * e.unknowns, OPERATIONS * words**2 * e.unknowns


@generators.register
def _(e: PlaneState) -> Iterator[Generator]:
    for odd in (True, False) if e.mesh.folded else (False,):
        yield plane_generator(e, assemble_backward(e.mesh, odd=odd), odd=odd)


def plane_generator(state: PlaneState, e: Elements, *, odd: bool) -> Generator:
    """Return the generator of densities on the elements ``e`` of the stationary ``state``.

    M du/dt = −Kᵀ u, so that (s − A)⁻¹ is (K + s M)⁻ᵀ M.
    """
    u, q = state.table.flat[e.free] * e.one, e.displacement
    if not state.mesh.folded:
        q = q - u @ (e.M @ (q * e.one))
    vectors = e.M @ (q * e.one), q * u

    def solver(shift: complex, step: Step) -> Solve:
        factors = factorise_sparse(csc_array(e.K + shift * e.M)) if shift else e.factors
        step(1.0)
        return without_mass(lambda b: factors.solve(e.M @ b, "T"), e.load * (not odd), u)

    return Generator(u.size, solver, lambda row: vectors, e.M.__matmul__)
