"""The density of one mass in time, by finite elements in the plane."""

from collections.abc import Callable
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.sparse import csc_array

from averaging.phase_space.densities import expansion_density
from averaging.phase_space.krylov import EVERY, VECTORS, krylov
from averaging.phase_space.plane.elements import (
    RELIABILITY_SHARE,
    Elements,
    assemble_backward,
)
from averaging.phase_space.plane.mesh import energy_mesh
from averaging.phase_space.plane.oscillator import (
    FALL,
    HIGHER,
    TRIALS,
    States,
    orbit,
    oscillator_of,
    rarest_energy,
    require_start,
)
from averaging.phase_space.plane.stationary import (
    BYTES,
    FINER,
    OPERATIONS,
    OUTFLOW,
    PANEL,
    PlaneState,
    plane_ladder_of,
    state_of,
)
from averaging.phase_space.refinement import Ladder, Options
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
    require_start(start, system)
    if start.kind in ("energy", "modal") and not start.rest:
        (energy,) = start.values.values()
        states: Callable[[int], States] = lambda points: orbit(o, energy, None, points)  # noqa: E731
    else:
        q, p = start.state(1)
        o, energy = replace(o, even=o.even and start.rest), float(o.energy(q, p / o.mass)[0])
        states = lambda points: (q, p / o.mass, np.ones(1))  # noqa: E731
    # Above the start, the noise feeds at most D/m a unit of time into an undamped motion.
    spread = np.sqrt(energy) + np.sqrt(2.0 * FALL * o.noise / o.mass * times[-1])
    try:
        top = min(energy + rarest_energy(o), spread**2)
    except NotCertified:
        top = spread**2
    ladders: list[Ladder] = []
    coarser: list[PlaneState] = []
    for level in count():
        for _ in range(TRIALS):
            mesh = energy_mesh(o, top, level, PANEL * FINER**level)
            limit = options.refusal(BYTES * mesh.unknowns, OPERATIONS * mesh.unknowns)
            if level > 1 and limit:
                break
            e = assemble_backward(mesh)
            now, changed = evolved(e, e.at(*states(4 * mesh.degree)), times, asked.tol)
            lost = abs(1.0 - float(now[-1].table.flat[e.free] @ (e.load * e.one)))
            # Krylov spaces do not keep the mass: what they miss is in the stated error.
            if lost < OUTFLOW + changed[-1]:
                break
            top *= HIGHER
        if level > 1 and limit:
            break
        options.step(f"transient, mesh {level + 1}")(0.0)
        if coarser:
            ladders = [
                plane_ladder_of(a, b, [observable], added=c)
                for a, b, c in zip(now, coarser, changed, strict=True)
            ]
            if max(ladder.errors[observable] for ladder in ladders) <= asked.tol:
                break
        coarser, top = now, top * HIGHER ** (1.0 / TRIALS)
    found = [replace(x, limit=limit) for x in ladders]
    densities = [expansion_density(x, observable, asked.tol) for x in found]
    at = [density.at(*asked.at) for density in densities]
    settings = {
        "equation": "(6)",
        "solver": "fem",
        "solved_by": "finite elements in the plane of displacement and momentum",
        "unknowns": found[0].finest.unknowns,
        "degree": found[0].finest.mesh.degree,
    }
    return transient_of(times, densities, at, tol=asked.tol, settings=settings)


def evolved(
    e: Elements, start: Array, times: Array, tol: float
) -> tuple[list[PlaneState], list[float]]:
    """Return the densities at ``times`` and the L1 changes by the last Krylov vectors.

    ``start`` is the functional of the initial state, see ``Elements.at``. Mᵀ y' = −Kᵀ y,
    Mᵀ y(0) = ``start``, is solved by Galerkin's method on the Krylov space of (K + σM)⁻ᵀ Mᵀ and
    (K + σM)⁻ᵀ ``start``, orthonormal in M, up to ``VECTORS`` vectors.
    """
    KT, MT, (_, factors) = csc_array(e.K.T), csc_array(e.M.T), e.shifted
    first: Any = factors.solve(start, "T")
    spaces = krylov(
        lambda x: factors.solve(MT @ x, "T"), first[:, None], VECTORS, metric=e.M.__matmul__
    )
    # ∫|p − p'| <= ‖y − y'‖_M (∫ exp(−Ψ))^½, by the inequality of Cauchy and Schwarz.
    size = float(np.sqrt(e.one @ e.load))
    images, last = np.zeros((0, start.size)), np.zeros((times.size, 0))
    changes = [np.full(times.size, np.inf)]
    for V, _, closed in spaces:
        if len(V) % EVERY and not closed:
            continue
        images = np.vstack([images, (KT @ V[len(images) :].T).T])
        generator, initial = V @ images.T, V @ start
        before = np.pad(last, ((0, 0), (0, len(V) - last.shape[1])))
        # Damping terms can let small spaces grow where the density does not.
        with np.errstate(over="ignore", invalid="ignore"):
            now = np.array([expm(-t * generator) @ initial for t in times])
            change = size * np.linalg.norm(now - before, axis=1)
        changes.append(np.where(np.isfinite(change), change, np.inf))
        last = now
        if np.max(changes[-1]) <= RELIABILITY_SHARE * tol and np.max(changes[-2]) <= tol:
            break
    states = [state_of(e, y @ V) for y in last]
    return states, changes[-1].tolist()
