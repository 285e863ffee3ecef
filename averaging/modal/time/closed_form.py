"""Modal energies in time in closed form: independent square-root processes, Eqs. (17), (33).

It holds without contact, where the damping is constant.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import prod

import numpy as np

from averaging.gaussian_state import state_rows
from averaging.modal.analysis import ModalAnalysis
from averaging.time.orbits import orbit_transient
from averaging.time.start import (
    FROM_NOISE,
    DensityQuestion,
    EnergyStart,
    limited_modes,
    observed_modes,
)
from fpk.arrays import EPS, SMALLEST, Array
from fpk.certificate import Measured, certify
from fpk.dynamics import Rates, certified_rates
from fpk.errors import NotApplicable
from fpk.evolution import Passage, Transient, certified_passage, checked_times
from fpk.limit import Limit
from fpk.modulation import ROUND_OFF, Modulation
from fpk.number import Number
from fpk.quadrature import panel_rule
from fpk.square_root import SquareRoot

SUM_PANELS, SUM_POINTS = 16, (20, 24)
"""Panels and Gauss points of each along H1 + H2 = H: answer and error."""
DECAY_PANELS, DECAY_POINTS = 80, (14, 18)
"""Panels, equidistant in ln t, and Gauss points of each of ∫ P(T > t) dt: answer and error."""
EARLY, SETTLED = 1e-13, 60.0
"""The first and the last of these times, in units of the mean time of rare failures."""
DensityOf = Callable[[Array], tuple[Array, Array]]


def transient(
    modes: ModalAnalysis, asked: DensityQuestion, modulation: Modulation | None
) -> Transient:
    """Return products of the densities of modal energies, or the convolution of two of them.

    Of displacements and momenta, what follows from them with independent uniform phases, (35).
    ``modulation`` is of the noise.
    """
    observable, start, times, at = asked.observable, asked.start, asked.times, asked.at
    if {c.kind for c in observable} <= {"q", "p"}:
        # The shares of the modes in displacements and momenta: (q, p) = S (ω Q, P).
        shapes = modes.state_shapes[state_rows(observable, modes.n)]
        orbits = []
        for m, H in enumerate(start.energies.tolist()):
            S = shapes[:, [m, m + modes.n]]
            orbits.append((_mode(modes, m, modulation), H, S @ S.T))
        return orbit_transient(orbits, asked)
    checked_times(times, positive=start.noise is None)
    rows = observed_modes(observable)
    parts = [
        (_mode(modes, m, modulation), float(start.energies[m])) for m in rows or range(modes.n)
    ]
    if not rows and (alike := _alike(modes, modulation)):
        parts = [(alike, float(start.energies.sum()))]
    if len(parts) > max(len(rows), 2):
        raise NotApplicable(
            "the sum of more than two modal energies that are not alike is not given"
        )
    values, errors = np.empty((2, times.size, at[0].size))
    worst = np.zeros(2)  # of the L1 errors and of the departures of the mass from 1
    for k, t in enumerate(times.tolist()):
        each = [partial(mode.density, H, start.noise, t) for mode, H in parts]
        if len(parts) == len(at):
            p, e = zip(*(part(x) for part, x in zip(each, at, strict=True)), strict=True)
            values[k] = prod(p)
            errors[k] = sum(e[i] * prod(p[:i] + p[i + 1 :]) for i in range(len(p)))
        else:
            values[k], errors[k] = _convolved(each, at[0])
        judged = [mode.judged(H, start.noise, t) for mode, H in parts]
        worst = np.maximum(worst, np.sum(judged, axis=0)[:2])
    highest = np.max(errors / np.max(values, axis=1, initial=SMALLEST, keepdims=True), initial=0.0)
    l1, defect = float(np.max([worst[0], highest])), float(worst[1])
    measured = Measured(l1, defect, float(values.min(initial=0.0)), None, None)
    certificate = certify(measured, tol=asked.tol)
    return Transient(times, values, errors + SMALLEST, "numerical", certificate)


def passage(
    modes: ModalAnalysis, limit: Limit, start: EnergyStart, times: Array, *, tol: float
) -> Passage:
    """Return the first passage of one modal energy, of any of several, or of their sum."""
    checked_times(times)
    limits = limited_modes(limit, start)
    if start.noise is not None:
        raise NotApplicable(FROM_NOISE)
    if not limits:
        if (alike := _alike(modes)) is None:
            raise NotApplicable(
                "of modes of unequal decay or temperature H has no closed form in time; use fem"
            )
        return alike.passage(limit.value, float(start.energies.sum()), times, tol=tol)
    parts = [(_mode(modes, m), a, float(start.energies[m])) for m, a in limits.items()]
    if len(parts) == 1:
        ((mode, a, H),) = parts
        return mode.passage(a, H, times, tol=tol)
    rates = [mode.rate(a) for mode, a, _ in parts]
    rate = Number(sum(r.value for r in rates), sum(r.error for r in rates))
    survival, lost = _product(parts, times, tol)
    return certified_passage(
        (*_first_of(parts, rate.value, tol), rate), times, 1.0 - survival, lost, tol=tol
    )


def relaxation(modes: ModalAnalysis, count: int, *, tol: float) -> Rates:
    """Return the ``count`` slowest rates but 0: sums of multiples of c*_ii."""
    rates = np.zeros(1)
    for m in range(modes.n):
        multiples = np.append(0.0, _mode(modes, m).rates(count, tol=1.0).values.real)
        rates = np.sort(np.add.outer(rates, multiples).ravel())[: count + 1]
    errors = (modes.relative_error + 4.0 * EPS) * rates[1:]
    return certified_rates(rates[1:], errors, tol=tol)


def _mode(modes: ModalAnalysis, m: int, modulation: Modulation | None = None) -> SquareRoot:
    """The energy of one mode; raises ``NotApplicable`` where its damping is not constant."""
    if not modes.constant:
        raise NotApplicable("damping that depends on the state has no closed form in time; use fem")
    c, d = float(modes.modal_damping[m, m]), float(modes.noise[m])
    error = modes.relative_error + (ROUND_OFF if modulation else 0.0)
    return SquareRoot(1, c, d, error, modulation)


def _alike(modes: ModalAnalysis, modulation: Modulation | None = None) -> SquareRoot | None:
    """The sum of modes of equal decay and temperature, with what they differ by as an error.

    That is up to 1e-12 of these, beyond their round-off.
    """
    one, c, d = _mode(modes, 0, modulation), np.diag(modes.modal_damping), modes.noise
    unlike = float(max(np.ptp(c) / c[0], np.ptp(d) / d[0]))
    if unlike > 1e-12 + 4.0 * modes.relative_error:
        return None
    return replace(one, n=modes.n, relative_error=one.relative_error + unlike)


def _convolved(parts: Sequence[DensityOf], energy: Array) -> tuple[Array, Array]:
    """∫p_1(x) p_2(H − x) dx, and its error, panels graded to both ends."""
    H = np.maximum(energy, 0.0)[:, None]
    nodes = np.sin(np.linspace(0.0, 0.5 * np.pi, SUM_PANELS + 1)) ** 2
    totals = []
    for points in SUM_POINTS:
        s, w = (a.ravel() for a in panel_rule(nodes, points))
        (p, p_error), (r, r_error) = parts[0](H * s), parts[1](H * (1.0 - s))
        totals.append((H[:, 0] * ((p * r) @ w), H[:, 0] * ((p * r_error + p_error * r) @ w)))
    (coarse, _), (fine, own) = totals
    return fine, own + np.abs(fine - coarse)


def _product(
    parts: Sequence[tuple[SquareRoot, float, float]], times: Array, tol: float
) -> tuple[Array, Array]:
    """P(T > t) of the first of independent passages, and its error."""
    failures = [mode.failure(a, H, times, tol=tol) for mode, a, H in parts]
    return np.asarray(prod(1.0 - p for p, _ in failures)), np.asarray(sum(e for _, e in failures))


def _first_of(
    parts: Sequence[tuple[SquareRoot, float, float]], rate: float, tol: float
) -> tuple[Number, Number]:
    """Mean and variance of the least of independent times: ∫S dt and ∫2t S dt, S the product.

    Before the first time S lies between its value then and 1; after the last it is a multiple of
    e^(−rate t).
    """
    ends = np.array([EARLY, SETTLED]) / rate
    nodes = np.log(np.geomspace(ends[0], ends[1], DECAY_PANELS + 1))
    answers = []
    for points in DECAY_POINTS:
        t, w = panel_rule(nodes, points)
        order = np.exp(t.ravel())
        S, lost = _product(parts, order, tol)
        weights = w.ravel()[:, None] * order[:, None] ** [1, 2] * [1.0, 2.0]
        answers.append((S @ weights, lost @ weights))
    (coarse, _), (fine, own) = answers
    (first, last), _ = _product(parts, ends, tol)
    beyond = abs(last) / rate * np.array([1.0, 2.0 * (ends[1] + 1.0 / rate)])
    before = ends[0] ** np.array([1, 2])
    mean, square = fine + 0.5 * (1.0 + first) * before
    error, square_error = np.abs(fine - coarse) + own + (1.0 - first) * before + beyond
    variance = Number(float(square - mean**2), float(square_error + 2.0 * mean * error))
    return Number(float(mean), float(error)), variance
