"""The density of one mass in time, by finite elements in the plane."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from averaging.phase_space.densities import expansion_density
from averaging.phase_space.plane.elements import assemble_backward
from averaging.phase_space.plane.mesh import Mesh
from averaging.phase_space.plane.oscillator import (
    FALL,
    oscillator_of,
    rarest_energy,
    start_states,
)
from averaging.phase_space.plane.stationary import (
    FINER,
    OUTFLOW,
    PANEL,
    PlaneState,
    plane_ladder_of,
    state_of,
    uniform_solutions,
)
from averaging.phase_space.refinement import Options
from fpk.answer.dynamics import Transient, require_times, transient_of
from fpk.answer.names import observable_name
from fpk.answer.question import Asked
from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotApplicable, NotCertified


def plane_transient(asked: Asked, options: Options) -> Transient:
    """Return the densities ``asked`` for, of one or two of (q, p) of one mass, in time.

    Meshes are refined until the L1 distance of two solutions, at every time, is within the
    tolerance, or memory or work ends this. The start is a state or an energy. Raises as
    ``fpk.answer.question`` says.
    """
    system, start, observable = asked.system, asked.start, asked.observable
    times, o = require_times(asked.times, positive=True), oscillator_of(system)
    if any(c.kind == "H" for c in observable):
        words = "in phase space the densities of q and p are given, not those of energies"
        raise NotApplicable(f"{observable_name(observable)}: {words}")
    energy, states = start_states(o, start, system)
    o = replace(o, even=o.even and (start.kind != "state" or start.rest))
    # Above the start, the noise feeds at most D/m a unit of time into an undamped motion.
    spread = np.sqrt(energy) + np.sqrt(2.0 * FALL * o.noise / o.mass * times[-1])
    try:
        top = min(energy + rarest_energy(o), spread**2)
    except NotCertified:
        top = spread**2

    def solved(mesh: Mesh) -> tuple[tuple[list[PlaneState], Array], bool]:
        e = assemble_backward(mesh)
        begin = e.at(*states(4 * mesh.degree))
        # A state is no function of the space: it begins with (K + σM)⁻ᵀ times it.
        first = e.shifted[1].solve(begin, "T")
        y, changes = e.in_time(begin, 0.0 * begin, first, times, tol=asked.tol, trans="T")
        # Krylov spaces do not keep the mass: what they miss is in the stated error.
        lost = abs(1.0 - float(y[-1] @ e.load))
        return ([state_of(e, own) for own in y], changes), not lost < OUTFLOW + changes[-1]

    solutions = uniform_solutions(o, top, (PANEL, FINER), solved, options)
    for level, (((coarser, _), _), ((now, changes), limit)) in enumerate(pairwise(solutions), 2):
        options.step(f"transient, mesh {level}")(0.0)
        ladders = [
            plane_ladder_of(a, b, [observable], added=c)
            for a, b, c in zip(now, coarser, changes.tolist(), strict=True)
        ]
        if limit or max(x.errors[observable] for x in ladders) <= asked.tol:
            break
    densities = [expansion_density(replace(x, limit=limit), observable, asked.tol) for x in ladders]
    at = [density.at(*asked.at) for density in densities]
    settings = now[0].mesh.settings(now[0].unknowns)
    return transient_of(times, densities, at, tol=asked.tol, settings=settings)
