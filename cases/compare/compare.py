"""Comparison of two answers to one question, and which of three errors separates them.

numerical
    two deterministic answers; the allowed difference is the sum of their stated errors.
sampling
    a histogram against a density that is exact for the full system; the allowed difference is
    exceeded by chance at the false-alarm rate ``FALSE_ALARMS``.
averaging
    an averaged theory against the full system; the difference is a property of the theory, reported
    with its own uncertainty and never judged.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import combinations
from typing import Literal

import numpy as np

from fpk.answer.density import AnyDensity, Density, distance_with_error
from fpk.answer.method import Result, Route
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import Array
from sim.sample.diagnostics import largest_by_chance

Measures = Literal["numerical", "sampling", "averaging"]

Norm = Literal["L1", "relative", "absolute"]
"""Norm of a difference: L1 for densities; for numbers absolute or relative to the second number."""

SIGN_DRAWS, SIGN_SEED = 2000, 20040808
"""Draws of the wild bootstrap, and their seed: a histogram always gets the same band."""

BINS_1D, BINS_2D = 128, 32
"""Approximate number of bins on each axis of a compared histogram, in one and two dimensions."""

WithError = tuple[AnyDensity, float, float]
"""A density as it is compared (a histogram in joined bins), its expected L1 error, and its largest,
which a sample exceeds at the rate ``FALSE_ALARMS``."""

ROUND_OFF = -float(np.log(np.finfo(float).eps) * np.finfo(float).eps)
"""Smallest L1 error of a density p = exp(−φ): p has the relative error eps·φ, and φ reaches
−log(eps) before p is negligible; 8e-15."""


@dataclass(frozen=True)
class Comparison:
    """The difference of two answers to one question, and the largest allowed difference.

    ``L1`` is ∫|p_a − p_b| of two densities, or the difference of two numbers in the ``norm``.
    ``band`` is the allowed difference, None for a difference that is reported and not judged.
    ``error``: uncertainty of ``L1`` by chance and by the solvers. ``uncertified`` names the routes
    whose own checks fail: the difference is then no finding against the other route. ::

        for c in fpk.compare(fpk.solve(fpk.load("fig3a").system, ["q2"])):
            print(c.measures, c.L1, c.error, c.band, c.holds)
    """

    observable: str
    a: Route
    b: Route
    measures: Measures
    L1: float
    band: float | None
    error: float
    uncertified: tuple[Route, ...] = ()
    norm: Norm = "L1"

    @property
    def holds(self) -> bool:
        """Whether the difference is allowed; True if it is not judged."""
        return self.band is None or bool(self.band >= self.L1)

    def __str__(self) -> str:
        """Return the comparison in one line."""
        judged = "reported" if self.band is None else f"allowed {self.band:.2g}"
        names = f"{self.observable}, {self.a.label} and {self.b.label}"
        difference = f"{self.norm} = {self.L1:.4g} ± {self.error:.1g}"
        return f"{names}: {self.measures}, {difference}, {judged}"


def compare_densities(
    results: Sequence[Result], *, averaging_is_exact: bool
) -> tuple[Comparison, ...]:
    """Return the comparison of every pair of ``results`` in every observable they share.

    ``averaging_is_exact``: the compatibility condition (8) holds, so that averaged theories
    coincide with the exact one (end of section 6.2) unless they neglect an effect. Two histograms
    on different bins are not compared.
    """
    comparisons = []
    answers = [(r, d, _with_error(d)) for r in results for d in r.densities]
    for (of_a, a, first), (of_b, b, second) in combinations(answers, 2):
        if a.observable != b.observable:
            continue
        both_sampled = isinstance(a, SampledDensity) and isinstance(b, SampledDensity)
        if both_sampled and not all(map(np.array_equal, a.panels, b.panels)):
            continue  # bin by bin; a function between them is compared with both
        routes = (of_a.method.route, of_b.method.route)
        exact = averaging_is_exact and not (of_a.neglected or of_b.neglected)
        kind = what_is_measured(*routes, averaging_is_exact=exact)
        distance, expected, band = _distance(first, second)
        allowed = None if kind == "averaging" else band
        pairs = zip(routes, (a, b), strict=True)
        uncertified = tuple(route for route, d in pairs if not d.certificate.certified)
        comparisons.append(
            Comparison(a.name, *routes, kind, distance, allowed, expected, uncertified)
        )
    return tuple(sorted(comparisons, key=lambda c: c.observable))


def discrepancies(
    comparisons: Sequence[Comparison], failing: Sequence[Comparison] | None = None
) -> tuple[str, ...]:
    """Return in words every difference that is not allowed, and which answer it speaks against.

    ``failing`` are the ``comparisons`` to report; None: all that do not hold. An answer is
    confirmed by another that agrees with it and shares no step of the calculation.
    """
    return tuple(
        f"{c.observable}: {c.a.label} and {c.b.label} differ by {c.norm} = {c.L1:.3g}, allowed"
        f" is {c.band:.3g} ({c.measures}){_doubt(c, comparisons)}"
        for c in (comparisons if failing is None else failing)
        if not c.holds
    )


def _doubt(difference: Comparison, comparisons: Sequence[Comparison]) -> str:
    """Return in words, "; …", which answer a difference speaks against; empty if undecided."""
    routes = (difference.a, difference.b)
    if doubtful := difference.uncertified:
        others = [r.label for r in routes if r not in doubtful]
        innocent = f": no finding against {others[0]}" if others else ""
        verb = "is" if others else "are"
        return f"; {' and '.join(r.label for r in doubtful)} {verb} not certified{innocent}"
    agreeing = [
        (route.label, (c.b if c.a == route else c.a).label)
        for route in routes
        for c in comparisons
        if c.observable == difference.observable and route in (c.a, c.b)
        # Where just one of the two is sampled, no step of the calculation is shared.
        if c.a.sampled != c.b.sampled
        if c.band is not None and c.holds and not c.uncertified
    ]
    if len({route for route, _ in agreeing}) != 1:
        return ""
    route, other = agreeing[0]
    return f"; {route} agrees with {other}, which is calculated independently"


def what_is_measured(a: Route, b: Route, *, averaging_is_exact: bool) -> Measures:
    """Return which of the three errors separates the answers of two routes.

    "averaging" if one solves an averaged equation, the methods differ and ``averaging_is_exact`` is
    False; else "sampling" if one is sampled, else "numerical".
    """
    averaged = "averaged" in (a.solves, b.solves)
    if averaged and a.method != b.method and not averaging_is_exact:
        return "averaging"
    return "sampling" if a.sampled or b.sampled else "numerical"


def distance_between(a: AnyDensity, b: AnyDensity) -> tuple[float, float, float]:
    """Return ∫|p_a − p_b|, its expectation if both are right, and the largest allowed value.

    The second contains the error of the integral; the third is exceeded at ``FALSE_ALARMS``.
    """
    return _distance(_with_error(a), _with_error(b))


def _with_error(density: AnyDensity) -> WithError:
    if isinstance(density, Density):
        error = density.l1_error + ROUND_OFF
        return density, error, error
    few = join_bins(density)
    return few, *chance_l1(few)


def _distance(a: WithError, b: WithError) -> tuple[float, float, float]:
    distance, error = distance_with_error(a[0], b[0])
    return distance, a[1] + b[1] + error, a[2] + b[2]


def chance_l1(sampled: SampledDensity) -> tuple[float, float]:
    """Return the mean of ∫|p_sampled − p_true| by chance, and its quantile at ``FALSE_ALARMS``.

    Wild bootstrap: random signs on the deviations of the independent batches keep the correlation
    of neighbouring bins. The quantile, out of reach of ``SIGN_DRAWS`` draws, is Student's t for the
    number of batches, corrected for the skewness of the draws (Cornish-Fisher).
    """
    batches = sampled.batch_values.reshape(sampled.batch_values.shape[0], -1)
    count = batches.shape[0]
    areas = reduce(np.multiply.outer, map(np.diff, sampled.edges)).ravel()
    weighted = (batches - batches.mean(axis=0)) * areas / np.sqrt(count * (count - 1.0))
    signs = np.random.default_rng(SIGN_SEED).choice([-1.0, 1.0], size=(SIGN_DRAWS, count))
    shares = signs @ weighted
    # The last term is one bin for everything outside of the histogram, as in ``l1_distance``.
    draws: Array = np.abs(shares).sum(axis=1) + np.abs(shares.sum(axis=1))
    mean, spread = float(draws.mean()), float(draws.std(ddof=1))
    if spread == 0.0:
        return mean, mean
    z = largest_by_chance(count, 1, sides=1)
    skewness = float(np.mean(((draws - mean) / draws.std()) ** 3))
    z += (z * z - 1.0) * max(skewness, 0.0) / 6.0
    return mean, mean + z * spread


def join_bins(sampled: SampledDensity, bins: int | None = None) -> SampledDensity:
    """Return the histogram in ``bins`` or more bins an axis, None: ``BINS_1D``, ``BINS_2D``."""
    wanted = bins or (BINS_1D if len(sampled.edges) == 1 else BINS_2D)
    return sampled.joined(min(sampled.values.shape) // wanted)
