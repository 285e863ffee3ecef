"""Averaging errors that are not known, tails that are off by a factor, answers to doubt."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from averaging.energy_process import compatibility
from fpk.answer.contacts import stop_clearances
from fpk.answer.density import AnyDensity
from fpk.answer.method import Route
from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotApplicable
from fpk.system.linear import linear_covariance
from fpk.system.system import System

ACCEPTABLE_L1 = 0.1
"""L1 distance to the full system up to which a theory is called acceptable: no probability is
wrong by more than 5 %."""

TAIL_FACTOR = 1.5
"""Smallest ratio, or inverse ratio, of an averaged to the full system's tail probability that is
reported: an L1 distance, which weighs the bulk, does not show it."""

REPORTED_TAILS = 1e-6, 1e-5, 1e-4, 1e-3, 1e-2
"""Probabilities of a tail; the least that the reference knows to 10 % is compared."""


def tails_off(densities: Mapping[Route, AnyDensity]) -> Iterator[dict[str, Any]]:
    """Yield the tail of each averaged theory that, less its error, is off by ``TAIL_FACTOR``.

    ``densities``: of one coordinate, by route. A row has the ``observable``, the ``theory``, the
    ``level`` x, the ``side`` ("above", or "below" except for energies), the ``probability`` beyond
    it by the ``reference``, the label of the full system's answer of least L1 error, the ``ratio``
    of the theory's probability to it and its ``error``, two standard errors of a sample included.
    The side that is further off is given. Sampled theories are left out; nothing is yielded without
    an answer of the full system.
    """
    full = [(d.l1_error, k, r) for k, (r, d) in enumerate(densities.items()) if r.solves == "full"]
    theories: dict[str, Route] = {}
    for route in densities:
        if route.solves == "averaged" and not route.sampled:
            theories.setdefault(route.method, route)
    if not full or not theories:
        return
    reference = min(full)[-1]
    best = densities[reference]
    sides = ["above"] if best.observable[0].kind == "H" else ["above", "below"]
    for theory in theories.values():
        rows: list[dict[str, Any]] = []
        for side in sides:
            for share in REPORTED_TAILS:
                level = best.quantile(1.0 - share if side == "above" else share).value
                beyond = "exceedance" if side == "above" else "cdf"
                known, other = (getattr(d, beyond)(level) for d in (best, densities[theory]))
                slack = (1 + reference.sampled) * known.error / known.value if known.value else 1.0
                if slack <= 0.1:
                    ratio = other.value / known.value
                    error = other.error / known.value + ratio * slack
                    row = {"side": side, "level": level, "probability": known.value}
                    rows.append({**row, "ratio": ratio, "error": error})
                    break
        off = [(max(r["ratio"] - r["error"], 1.0 / (r["ratio"] + r["error"])), r) for r in rows]
        worst, row = max(off, key=lambda pair: pair[0], default=(0.0, {}))
        if worst > TAIL_FACTOR:
            names = {"theory": theory.method, "reference": reference.label}
            yield {"observable": best.name, **names, **row}


def incompatibility(system: System) -> str | None:
    """Return why the exact theory (7), (8) does not apply; None if it applies."""
    try:
        compatibility(system)
    except NotApplicable as reason:
        return str(reason)
    return None


def rms_ratios(system: System) -> tuple[Array, float, float]:
    """Return how energy averaging without contacts errs, the spread of energies, and the damping.

    First the rms of q_1 …, v_1 … (2n,) if all modes had the temperature Σ D_ii/m_i / Σ c_ii/m_i,
    over the exact rms; then the largest E P_m² of a mode over the least; then the largest damping
    ratio c*_mm/(2 ω_m). Raises ``NotApplicable`` if the motion without contacts has no Gaussian law
    or some variance is 0.
    """
    exact, n = system.fact(linear_covariance), system.n
    states = np.kron(np.eye(2), exact.shapes) / np.append(exact.omega, np.ones(n))
    variances, energies = np.diag(states @ exact.covariance @ states.T), np.diag(exact.covariance)
    if not min(*variances, *energies) > 0.0:
        raise NotApplicable("some motion without contacts gets no energy")
    c = np.diag(exact.shapes.T @ system.damping @ exact.shapes)
    one = np.sum(np.diag(system.noise_matrix) / system.mass) / np.sum(c)
    ratios = np.sqrt(one * np.sum(states**2, axis=1) / variances)
    spread = float(np.max(energies[n:]) / np.min(energies[n:]))
    return ratios, spread, float(np.max(0.5 * c / exact.omega))


def averaging_notes(
    system: System, answers: Iterable[tuple[str, Iterable[Route], bool]]
) -> tuple[str, ...]:
    """Return the notes of ``unknown_averaging_errors``, each behind the names of its answers."""
    return notes_in_words(unknown_averaging_errors(system, answers))


def notes_in_words(notes: Mapping[str, Iterable[str]]) -> tuple[str, ...]:
    """Return each note behind the names of its answers: ``q1, H: averaging error not known``."""
    return tuple(f"{', '.join(own)}: {note}" for note, own in notes.items())


def unknown_averaging_errors(
    system: System, answers: Iterable[tuple[str, Iterable[Route], bool]]
) -> dict[str, list[str]]:
    """Return notes on ``answers`` and the names of the answers to which each applies.

    An answer is a name, the routes that give it, and whether it is about motion in time. There is
    no note with an answer of the full system, or if averaging is exact: under condition (8), if the
    motion is stationary and no stop is left out. A note says to doubt an answer where the theory
    errs by more than ``ACCEPTABLE_L1`` in an rms without contacts, leaves out a stop within the
    rule of section 6.3, or, in time, where an energy swings by more than that share of itself
    within a period, which it does by the damping ratio.
    """
    exact, notes = incompatibility(system) is None, dict[str, list[str]]()
    for of, routes, in_time in answers:
        by = {route.method: route for route in routes}
        alone = [t for t in by if in_time or not exact or (t == "integrable" and system.stops)]
        if alone and all(route.solves == "averaged" for route in by.values()):
            notes.setdefault(_note(system, alone, in_time), []).append(of)
    return notes


def _note(system: System, theories: list[str], in_time: bool) -> str:
    words, doubt = ["averaging error not known here"], False
    with suppress(NotApplicable):  # without a Gaussian law nothing measures it
        ratios, spread, damping_ratio = rms_ratios(system)
        low, high = float(np.min(ratios)), float(np.max(ratios))
        doubt = in_time and damping_ratio > ACCEPTABLE_L1
        if "nonintegrable" in theories:
            doubt |= max(1.0 - low, high - 1.0) > ACCEPTABLE_L1
            gives = f"nonintegrable gives {low:.3g} to {high:.3g} times the exact rms"
            words.append(f"without contacts {gives} of each q and v")
        words.append(f"modal temperatures differ by a factor of {spread:.2g}")
        words.append(f"damping ratios are up to {damping_ratio:.2g}")
    near = [s.ratio for s in system.fact(stop_clearances) if s.beyond_rule is False and s.ratio]
    if "integrable" in theories and near:
        words, doubt = [*words, f"a stop at {min(near):.2g} rms is left out"], True
    return "; ".join(words) + ": doubt it" * doubt
