"""Initial states of trajectories, motion from time to time, and rounds until a tolerance is met."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from math import ceil, inf
from typing import Any

import numpy as np
from numpy.random import Generator

from fpk.answer.certificate import tolerance
from fpk.answer.names import Start
from fpk.answer.question import Asked
from fpk.answer.sampled_density import standard_error
from fpk.numeric.arrays import Array, Flags
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.numeric.machine import pause_working_time, usable_cores, working_time
from fpk.system.linear import natural_modes
from fpk.system.system import System
from sim.questions.limits import CHUNK_STEPS, needs_steps
from sim.sample.ensemble import Ensemble, Reader, ensemble_from
from sim.sample.settings import LEAST_PATHS, Settings
from sim.sample.workers import interruptible, workers_of
from sim.step.arrays import LANES, in_rows
from sim.step.random import GOLDEN, start_displacements, stream_of
from sim.step.step_size import chosen_step, relaxation_time, temperature

MOST_STEPS, MOST_SAMPLES = 1 << 22, 64
"""Steps of all trajectories together, and samples of each, after which the wall time is checked."""

MOST_SUMS = 1 << 23
"""Largest size of the arrays of a round, in numbers of 8 bytes; and of the steps of a passage
between two looks at the wall time, all trajectories together."""


@dataclass(eq=False)
class Watch:
    """Ends a simulation when its error is <= ``tol``, after ``seconds`` of wall time, or by Ctrl-C.

    ``stopped()``: whether Ctrl-C was pressed and the answer may be partial. ``begin``: a value of
    ``working_time``.
    """

    seconds: float
    stopped: Callable[[], bool]
    tol: float | None = None
    begin: float = field(default_factory=working_time)

    def ends(self) -> bool:
        """Return whether Ctrl-C was pressed or ``seconds`` have passed since ``begin``."""
        return bool(self.stopped()) or working_time() - self.begin > self.seconds

    def until(
        self, answer: Callable[[int], float | None], *, least: int = 1, most: float = inf
    ) -> list[str]:
        """Call ``answer`` with 0, 1, … until its result, an error, is at most ``tol``.

        It is called ``least`` to ``most`` times, but not after ``ends()`` or a result None (cut
        short). Without ``tol`` it is called until a finite time ``seconds`` is over, else ``least``
        times. Return one sentence in a list if Ctrl-C was pressed, else an empty list.
        """
        number, more = 0, True
        while more and (error := answer(number)) is not None:
            number += 1
            goes_on = error > self.tol if self.tol is not None else self.seconds < inf
            more = (number < least or goes_on) and number < most and not self.ends()
        return ["partial: interrupted by Ctrl-C"] if self.stopped() else []

    def required(self, phase: str) -> Callable[[float], bool]:
        """Return a check of a ``phase``, which begins now and without which there is no answer.

        It is called with the share of the phase that is done and returns False. When the time is
        over it raises ``InvalidInput``, after Ctrl-C ``KeyboardInterrupt``.
        """
        begin = working_time()

        def check(share: float) -> bool:
            if not self.ends():
                return False
            if self.stopped():
                raise KeyboardInterrupt
            whole = (working_time() - begin) / share if share > 0.0 else inf
            needed = "longer" if whole == inf else f"about {whole:.2g} s"
            words = f"are over in {phase}, which takes {needed}; give it more"
            raise InvalidInput("seconds", self.seconds, words)

        return check


ACCEPTED = 1e-4
"""Least share of accepted proposals on an energy shell; with fewer no states are drawn."""


def initial_states(
    system: System,
    start: Start,
    seed: int,
    paths: int,
    number: int = 0,
    *,
    burn_in: float = 10.0,
    workers: Any = None,
    watch: Any = None,
) -> tuple[Array, Array]:
    """Return q and p (``paths``, n) at time 0 of round ``number`` of a ``seed``.

    A state is copied; an energy is drawn ``on_shell``; modal energies have random phases.
    Stationary states, under the noise that the ``start`` names, are burnt in for ``burn_in``
    relaxation times, if the ``watch`` allows (``Watch.required``). Raises ``NotApplicable`` if
    there is no stationary state, and as ``on_shell`` does.
    """
    n, stream = system.n, stream_of(seed, number)
    if start.kind == "energy" and not start.rest:
        return on_shell(system, start.values["H"], paths, stream)
    if start.kind == "modal":
        shapes, omega = natural_modes(system)
        phase = 2.0 * np.pi * stream.random((paths, n))
        size = np.sqrt(2.0 * np.array([start.values[f"H{m + 1}"] for m in range(n)]))
        q = (size / omega * np.cos(phase)) @ shapes.T
        return q, (size * np.sin(phase)) @ (system.mass[:, None] * shapes).T
    factor = start.values.get("noise", 0.0)
    if not factor:
        q, p = start.state(n)
        return np.tile(q, (paths, 1)), np.tile(p, (paths, 1))
    # Stationary under ``factor`` times the noise: a burn-in from Gaussian states at its kT.
    system = replace(system, noise_intensity=factor * system.noise_intensity)
    kT, time = temperature(system), burn_in * relaxation_time(system)
    if not np.isfinite(time):
        raise NotApplicable("some motion is not damped: no stationary state to start from")
    whole = -(-paths // LANES) * LANES
    q = start_displacements(system, kT, stream.standard_normal((n, whole))).T
    p = stream.standard_normal((n, whole)).T * np.sqrt(kT * system.mass)
    check = watch.required("the burn-in") if watch else lambda share: False
    ended = lambda share: share < 1.0 and check(share)  # noqa: E731
    other = seed_of(seed + 2**63, number)  # differs from the seeds of all rounds
    begun = partial(ensemble_from, system, q, p, seed=other, workers=workers)
    dt, many = (chosen_step(system), (2,)) if needs_steps(system) else (inf, (1,))
    ((states,),) = motions(begun, q, states_of, np.array([time]), dt, many, lambda: ended)
    q, p = np.split(states[:paths], 2, axis=1)
    return q, p


def states_of(ensemble: Ensemble) -> Array:
    """Return the states (q, p) of the last sample, (paths, 2n)."""
    return in_rows(ensemble.last)[:, : 2 * ensemble.system.n]


def motions(
    begun: Callable[..., Any],
    start: Any,
    seen: Callable[[Any], Any],
    times: Array,
    dt: float,
    many: tuple[int, ...] = (2, 1),
    begin: Callable[[], Callable[[float], bool]] = lambda: lambda share: False,
) -> Iterator[tuple[Any, ...]]:
    """Yield at each of the ascending ``times`` the tuple of ``seen(ensemble)`` of all motions.

    There is a motion for each number in ``many``, of so many steps for each step ``dt``; if ``dt``
    is inf, one step leads from time to time. At time 0 ``start`` itself is yielded in place of
    ``seen(ensemble)``. ``begun(dt=, halved=)`` returns an ensemble at time 0.
    ``begin()`` is called first; the function that it returns is called with the share of the time
    that is done, and ends the motions if it returns True.
    """
    now, running, ended = 0.0, list[Any](), begin()
    for time in times.tolist():
        if time > now:
            steps = max(1, ceil((time - now) / dt))
            parts = ceil(steps / CHUNK_STEPS)
            stride = ceil(steps / parts)
            long = (time - now) / (parts * stride)
            with pause_working_time():  # by the same random numbers
                running = [e.onward(long / each) for e, each in zip(running, many, strict=False)]
                running = running or [begun(dt=long / k, halved=k < many[0]) for k in many]
            for ensemble, each in zip(running, many, strict=True):
                for done in range(parts):
                    ensemble.advance(stride * each, stride=stride * each)
                    if ended((now + (time - now) * (done + 1) / parts) / times[-1]):
                        return
        now = time
        yield tuple(map(seen, running)) or (start,) * len(many)


def on_shell(system: System, energy: float, paths: int, stream: Generator) -> tuple[Array, Array]:
    """Return q and p (``paths``, n) drawn from the density δ(H − ``energy``) by ``stream``.

    Proposals are directions of the phase space, scaled so that H = r²/2 without contact. They are
    accepted with the weight r^(2n−1)/(∂H/∂r) at the r where H is the energy, relative to its bound
    R^(2n−2), R = √(2 energy). Raises ``NotApplicable`` if fewer than ``ACCEPTED`` are accepted.
    """
    n, many = system.n, max(paths, 4096)
    back = np.linalg.inv(np.linalg.cholesky(system.stiffness_matrix)).T
    root, most = np.sqrt(system.mass), np.sqrt(2.0 * energy)
    states: list[Array] = []
    proposed = wanted = 0
    while wanted < paths:
        u = stream.standard_normal((many, 2 * n))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        direction = np.hstack([u[:, :n] @ back.T, u[:, n:] * root])
        # The r where H is the energy, in every direction, by bisection to the last digit.
        low, high = np.full(many, 0.0 if system.stops else most), np.full(many, most)
        for _ in range(60 if system.stops else 0):
            middle = 0.5 * (low + high)
            above = system.hamiltonian(*np.split(middle[:, None] * direction, 2, axis=1)) > energy
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        radius = 0.5 * (low + high)
        state = radius[:, None] * direction
        by_contact = np.zeros(many)  # Σ g_i dq_i/dr, the part of ∂H/∂r by contact
        for stop in system.stops:
            overlap = np.maximum(stop.sign * state[:, stop.index] - stop.clearance, 0.0)
            by_contact += stop.sign * stop.force(overlap) * direction[:, stop.index]
        weight = (radius / most) ** (2 * n - 2) * radius / (radius + by_contact)
        accepted: Flags = stream.random(many) < weight
        states.append(state[accepted])
        proposed, wanted = proposed + many, wanted + int(np.count_nonzero(accepted))
        if proposed >= 2**18 and wanted < ACCEPTED * proposed:
            words = "is so far within the contacts that no states are drawn from it"
            raise NotApplicable(f"the shell H = {energy:g} {words}; begin in a state")
    q, p = np.split(np.concatenate(states)[:paths], 2, axis=1)
    return q, p


@contextmanager
def working(
    method: Settings, system: System, tol: float | None, start: Start | None = None
) -> Iterator[tuple[Any, ...]]:
    """Yield workers, a ``Watch`` with ``tol``, and ``origin(paths, number)`` by ``initial_states``.

    ``start`` None: stationary states. Wall time is limited by ``seconds``, or with ``tol`` by
    ``longest``.
    """
    start = start or Start("noise", {"noise": 1.0})
    seconds = method.seconds or (method.longest if tol is not None else inf)
    with (
        workers_of(method.cluster, method.threads or usable_cores()) as workers,
        interruptible(method.partial) as stopped,
    ):
        watch = Watch(seconds, stopped, tol)
        burn_in: Any = {"burn_in": method.burn_in, "workers": workers, "watch": watch}
        yield workers, watch, partial(initial_states, system, start, method.seed, **burn_in)


def seed_of(seed: int, number: int) -> int:
    """Return the seed of the trajectories of round ``number``, derived from ``seed``."""
    return (seed + number * int(GOLDEN)) % 2**64


Simulation = tuple[float, int, bool, Reader]
"""Step, steps per sample, ``halved`` (see ``Ensemble``), and reader of a simulation."""


def in_rounds(
    method: Settings,
    asked: Asked,
    simulations: Sequence[Simulation],
    samples: int,
    numbers: tuple[int, ...],
    estimate: Callable[[list[Array], Array, int], tuple[Array, float]],
    what: str,
    *,
    least: int = 0,
) -> tuple[Array, float, int, list[str]]:
    """Simulate in rounds until ``tol``; return estimates (blocks, points), scale, paths, failures.

    A round is a window of ``samples`` samples of new trajectories; if the time ends in it, it does
    not count, and in the first round ``InvalidInput`` is raised. With ``least`` a round is a chunk,
    one of ``least``, of one window of the same trajectories with every step read, and always
    counts. ``estimate`` gets the readers' arrays (blocks, *numbers) of each simulation, the rms q
    and v of mass ``asked.row``, and the samples of the round; it returns the estimates of all
    rounds, and their scale (1 is taken if it is not > 0).
    """
    system, row, onward = asked.system, asked.row, least > 0
    paths = -(-method.paths // LANES) * LANES
    size = len(simulations) * int(np.prod(numbers))
    own = paths if onward else max(2, min(paths // LANES, MOST_SUMS // size)) * LANES
    least = least or ceil(paths / own)
    piece = max(1, min(MOST_SAMPLES, MOST_STEPS // (own * simulations[0][1])))
    rounds, running, squares = 0, list[Ensemble](), list[Array]()
    blocks, scale = np.zeros(0), 1.0

    def advance_round(number: int) -> float | None:
        nonlocal rounds, running, blocks, scale
        if not (onward and running):
            seed, (q, p) = seed_of(method.seed, number), origin(own, number)
            begun = partial(ensemble_from, system, q, p, seed=seed, workers=workers)
            with pause_working_time():
                running = [begun(dt=dt, halved=halved) for dt, _, halved, _ in simulations]
        sums, done = [np.zeros((own // LANES, *numbers)) for _ in simulations], 0
        first, last = (samples * k // least for k in (number, number + 1))
        length = max(1, last - first) if onward else samples
        check = watch.required(f"the first {own} windows")
        while done < length and not (done and watch.ends()):
            many = min(piece, length - done)
            for ensemble, (_, k, _, read), array in zip(running, simulations, sums, strict=True):
                ensemble.advance(many * k, array, stride=1 if onward else k, read=read)
            done += many
        whole = done == length
        if not (whole or onward):
            if not number:
                check(done / length)
            return None
        rounds += whole
        squares.append(np.mean(in_rows(running[0].last)[:, [row, system.n + row]] ** 2, axis=0))
        rms = np.sqrt(np.mean(squares, axis=0)) / [1.0, system.mass[row]]
        blocks, scale = estimate(sums, rms, done)
        scale = scale if scale > 0.0 else 1.0
        asked.progress(min(rounds, least), least, what)
        return float(np.max(standard_error(blocks))) / scale if whole else None

    with working(method, system, tolerance(asked.tol, method.tol)) as (workers, watch, origin):
        failures = watch.until(advance_round, least=least)
    paths = own if onward else rounds * own
    if paths < LEAST_PATHS:
        failures.append(f"it ended after {paths} trajectories of {LEAST_PATHS}")
    return blocks, scale, paths, failures
