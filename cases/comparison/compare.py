"""Comparison of routes: what is left between two answers, and which of three errors it is.

numerical
    two deterministic answers to the same question; the difference may be what their own error
    estimates add up to.
sampling
    a histogram against a density that is exact for the full system; the difference may be what
    chance makes of it, at a false-alarm rate that is chosen first.
averaging
    an averaged theory against the full system; the difference is a property of the theory, it is
    reported with its own uncertainty and never judged.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from scipy.stats import skew
from scipy.stats import t as student

from fpk.density import AnyDensity, Array, Density, SampledDensity, l1_distance
from fpk.method import Method, Result

Measures = Literal["numerical", "sampling", "averaging"]

FALSE_ALARMS = 1e-4
"""How often a right simulation may be called wrong, chosen before anything was compared."""

SIGN_DRAWS, SIGN_SEED = 2000, 20040808
"""Draws of the wild bootstrap and their seed: the same histogram always gets the same band."""

BINS_1D, BINS_2D = 128, 32
"""About so many bins an axis are compared: enough to see the shape, few enough to fill."""

ROUND_OFF = -2.0 * float(np.log(np.finfo(float).eps) * np.finfo(float).eps)
"""Floor of a numerical band: both densities are exponentials, the exponent reaches −log(eps)
before they stop to count, and an exponential is off by eps times its exponent: 1.6e-14."""


@dataclass(frozen=True)
class Comparison:
    """Two answers to one question: ``L1 = ∫|p_a − p_b|`` and what it is allowed to be.

    ``band`` is None where the difference is reported, not judged; ``error`` says how far chance
    and the solvers may have moved ``L1`` itself.
    """

    observable: str
    a: str
    b: str
    measures: Measures
    L1: float
    band: float | None
    error: float
    holds: bool


def route_name(method: Method) -> str:
    """Return how tables and legends call a route, such as ``nonintegrable/fem``."""
    return method.route.label


def compared(results: Sequence[Result], *, averaging_is_exact: bool) -> tuple[Comparison, ...]:
    """Return the comparison of every pair of results in every observable they share.

    ``averaging_is_exact`` says that the exact theory applies, with which the averaged ones then
    coincide (end of section 6.2), unless they left out contacts, as their settings then say.
    """
    answers = [(r, d) for r in results for d in r.densities]
    found = []
    for (of_a, a), (of_b, b) in combinations(answers, 2):
        if a.observable == b.observable and not _on_different_bins(a, b):
            whole = not (of_a.neglected or of_b.neglected)
            kind = what_is_measured(
                of_a.method, of_b.method, averaging_is_exact=averaging_is_exact and whole
            )
            names = route_name(of_a.method), route_name(of_b.method)
            found.append(_comparison(*names, a, b, kind=kind))
    return tuple(sorted(found, key=lambda c: c.observable))


def _on_different_bins(a: AnyDensity, b: AnyDensity) -> bool:
    """Whether two histograms cannot be compared: a function between them can be, with both."""
    both = isinstance(a, SampledDensity) and isinstance(b, SampledDensity)
    return both and not all(map(np.array_equal, a.panels, b.panels))


def what_is_measured(a: Method, b: Method, *, averaging_is_exact: bool) -> Measures:
    """Return which of the three errors separates the answers of two methods."""
    averaged = any(m.route.solves == "averaged" for m in (a, b))
    if averaged and a.name != b.name and not averaging_is_exact:
        return "averaging"
    sampled = any(m.route.sampled for m in (a, b))
    return "sampling" if sampled else "numerical"


def _comparison(
    name_a: str, name_b: str, a: AnyDensity, b: AnyDensity, *, kind: Measures
) -> Comparison:
    distance, expected, band = _measured(a, b)
    allowed = None if kind == "averaging" else band
    return Comparison(
        observable=a.name,
        a=name_a,
        b=name_b,
        measures=kind,
        L1=distance,
        band=allowed,
        error=expected,
        holds=allowed is None or bool(distance <= allowed),
    )


def distance_between(a: AnyDensity, b: AnyDensity) -> tuple[float, float]:
    """Return ∫|p_a − p_b| and how far chance and the solvers may have moved it."""
    return _measured(a, b)[:2]


def _measured(a: AnyDensity, b: AnyDensity) -> tuple[float, float, float]:
    """∫|p_a − p_b|, its expectation were both right, and what it then exceeds in 1e-4."""
    estimates = sum(d.l1_error for d in (a, b) if isinstance(d, Density))
    sampled = [_joined(d) for d in (a, b) if isinstance(d, SampledDensity)]
    if not sampled:
        distance = l1_distance(a, b)
        return distance, estimates + ROUND_OFF, estimates + ROUND_OFF
    a, b = (_joined(d) if isinstance(d, SampledDensity) else d for d in (a, b))
    mean, quantile = np.array([chance_l1(d) for d in sampled]).sum(axis=0)
    return l1_distance(a, b), float(mean) + estimates, float(quantile) + estimates


def chance_l1(sampled: SampledDensity) -> tuple[float, float]:
    """Return the mean of ∫|p_sampled − p_true| by chance alone, and what it exceeds in 1e-4.

    Wild bootstrap: random signs on the deviations of the independent batches keep the correlation
    of neighbouring bins. The quantile is that of Student's t for the number of batches, corrected
    for the skewness of the draws (Cornish-Fisher): it lies beyond what 2000 draws can show.
    """
    batches = sampled.batch_values.reshape(sampled.batch_values.shape[0], -1)
    count = batches.shape[0]
    areas = np.ones(1)
    for edges in sampled.edges:
        areas = np.multiply.outer(areas, np.diff(edges)).ravel()
    weighted = (batches - batches.mean(axis=0)) * areas / np.sqrt(count * (count - 1.0))
    signs = np.random.default_rng(SIGN_SEED).choice([-1.0, 1.0], size=(SIGN_DRAWS, count))
    shares = signs @ weighted
    # The last term is the bin of all that lies outside, as in ``l1_distance``.
    draws: Array = np.abs(shares).sum(axis=1) + np.abs(shares.sum(axis=1))
    mean, spread = float(draws.mean()), float(draws.std(ddof=1))
    if spread == 0.0:
        return mean, mean
    z = float(student.isf(FALSE_ALARMS, count - 1))
    z += (z * z - 1.0) * max(float(skew(draws)), 0.0) / 6.0
    return mean, mean + z * spread


def _joined(sampled: SampledDensity) -> SampledDensity:
    """Join neighbouring bins until about ``BINS_1D`` (or ``BINS_2D`` an axis) are left."""
    wanted = BINS_1D if len(sampled.edges) == 1 else BINS_2D
    counts = [e.size - 1 for e in sampled.edges]
    factors = [f for f in range(1, min(counts) // wanted + 1) if not any(c % f for c in counts)]
    return sampled.coarsened(max(factors)) if factors else sampled
