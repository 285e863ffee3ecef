"""Claims held against numbers: findings about a source, never failures of the program."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, Protocol

import numpy as np

from cases.comparison.compare import distance_between
from cases.comparison.regime import Regime
from cases.scene.expect import Expect
from fpk.certificate import Certificate
from fpk.density import AnyDensity, Array, Density, SampledDensity, l1_distance, moment
from fpk.observable import Observable, observable_name

Verdict = Literal["holds", "does not hold", "undecided", "not checked"]

ALMOST_L1 = 0.05
"""L1 distance to the fitted Gaussian up to which a density is called almost Gaussian: no
probability is wrong by more than 2.5 %, about what the width of a printed line hides."""

ALMOST_KURTOSIS = 0.3
"""Excess kurtosis up to which it is called so: the fourth moment is a tenth off the Gaussian's 3.
A density must meet both to be almost Gaussian; one of them beyond makes it non-Gaussian."""

ACCEPTABLE_L1 = 0.1
"""L1 distance to the full system up to which a theory is called acceptable: no probability is
wrong by more than 5 %."""


class CurveFound(Protocol):
    """What the claims need to know of one curve."""

    @property
    def label(self) -> str:
        """The curve's label, empty for a lone one."""
        ...

    @property
    def value(self) -> float | None:
        """What is varied, as one number."""
        ...

    @property
    def regime(self) -> Regime:
        """What decides between the theories."""
        ...

    def densities(self, observable: Observable) -> Mapping[str, AnyDensity]:
        """Return the densities of one observable by route name."""
        ...


@dataclass(frozen=True)
class Finding:
    """One claim on one curve (or between two): what was measured and whether the claim holds."""

    claim: str
    curve: str
    measured: str
    verdict: Verdict


@dataclass(frozen=True)
class Shape:
    """How far a density is from the Gaussian of its own mean and variance; errors are bounds."""

    l1: float
    l1_error: float
    kurtosis: float
    kurtosis_error: float

    @property
    def almost_gaussian(self) -> bool | None:
        """Whether both measures are small; None where their errors leave it open."""
        near = [
            _below(self.l1, self.l1_error, ALMOST_L1),
            _below(abs(self.kurtosis), self.kurtosis_error, ALMOST_KURTOSIS),
        ]
        return False if False in near else None if None in near else True


def findings(expect: Expect | None, curves: Sequence[CurveFound]) -> tuple[Finding, ...]:
    """Return what became of every claim on every curve that it is about."""
    if expect is None:
        return ()
    found: list[Finding] = []
    for wanted, claim_range, words in (
        (False, expect.non_gaussian, "non-Gaussian"),
        (True, expect.almost_gaussian, "almost Gaussian"),
    ):
        if claim_range is None:
            continue
        for curve in curves:
            if curve.value is not None and curve.value in claim_range:
                symbol = curve.label.partition(" =")[0]
                claim = f"{observable_name(expect.of)} {words} for {symbol} {claim_range.words}"
                found.append(_gaussian(claim, curve, expect.of, wanted=wanted))
    if expect.nonintegrable_better_with is not None:
        found += _monotone(expect, curves)
    for curve in curves:
        found += _theories(expect, curve)
    return tuple(found)


def shape_of(density: AnyDensity) -> Shape:
    """Return excess kurtosis and L1 distance to the Gaussian of the same mean and variance."""
    mean = moment(density, 1)
    variance = moment(density, 2) - mean * mean
    kurtosis = _kurtosis(density)
    distance = l1_distance(density, _gaussian_density(density, mean, variance))
    if not isinstance(density, SampledDensity):
        # A relative error of the fourth moment is at most that of the mass far out: a bound by
        # the support, which ends where the density has died out.
        reach = max(abs(density.panels[0][0] - mean), abs(density.panels[0][-1] - mean))
        slack = density.l1_error * (reach**4 / variance**2)
        return Shape(distance, 2.0 * density.l1_error, kurtosis, float(slack))
    count = density.batch_values.shape[0]
    batches = [replace(density, values=v) for v in density.batch_values]
    spread = float(np.std([_kurtosis(b) for b in batches], ddof=1) / np.sqrt(count))
    chance = float(np.sum(density.standard_error * np.diff(density.edges[0])))
    return Shape(distance, chance, kurtosis, 3.0 * spread)


def reference_of(found: Mapping[str, AnyDensity]) -> AnyDensity | None:
    """Return the best answer for the full system: exact where there is one, else sampled."""
    return next((found[r] for r in ("exact", "linear", "montecarlo") if r in found), None)


def theory_of(found: Mapping[str, AnyDensity], name: str) -> AnyDensity | None:
    """Return the answer of an averaged theory, by closed form where there is one."""
    solvers = ("closed-form", "quadrature", "fem")
    return next((found[f"{name}/{s}"] for s in solvers if f"{name}/{s}" in found), None)


def _gaussian(claim: str, curve: CurveFound, of: Observable, *, wanted: bool) -> Finding:
    density = reference_of(curve.densities(of))
    if density is None:
        return Finding(claim, curve.label, "no answer for the full system", "not checked")
    shape = shape_of(density)
    measured = f"L1 to the fitted Gaussian {shape.l1:.3f}, excess kurtosis {shape.kurtosis:+.3f}"
    almost = shape.almost_gaussian
    return Finding(
        claim, curve.label, measured, _verdict(None if almost is None else almost is wanted)
    )


def _monotone(expect: Expect, curves: Sequence[CurveFound]) -> list[Finding]:
    """Compare neighbours along the varied number, the better one last."""
    direction = expect.nonintegrable_better_with
    symbol = curves[0].label.partition(" =")[0]
    claim = f"nonintegrable theory better with {direction} {symbol}"
    ordered = sorted(curves, key=lambda c: c.value or 0.0, reverse=direction == "smaller")
    found = []
    for worse, better in pairwise(ordered):
        where = f"{worse.label} to {better.label}"
        pair = [_distance(c, expect.of, "nonintegrable") for c in (worse, better)]
        if pair[0] is None or pair[1] is None:
            found.append(Finding(claim, where, "no answer to compare with", "not checked"))
            continue
        (a, slack_a), (b, slack_b) = pair[0], pair[1]
        measured = f"L1 {a:.4f} ± {slack_a:.4f} to {b:.4f} ± {slack_b:.4f}"
        found.append(Finding(claim, where, measured, _verdict(_less(b, slack_b, a, slack_a))))
    return found


def _theories(expect: Expect, curve: CurveFound) -> list[Finding]:
    found = []
    if expect.better is not None:
        first, second = expect.better
        found.append(_better(first, second, curve, expect.of))
    found += [
        _acceptable(f"{name} theory acceptable", name, curve, expect.of)
        for name in expect.acceptable
    ]
    rule = expect.clearance_rule
    ratios = [s.ratio for s in curve.regime.stops]
    if rule is not None:
        claim = f"integrable theory acceptable for clearance > {rule:g} rms"
        known = [r for r in ratios if r is not None]
        if not known or len(known) < len(ratios):
            found.append(Finding(claim, curve.label, "the rms is not known", "not checked"))
        elif min(known) > rule:
            found.append(_acceptable(claim, "integrable", curve, expect.of))
        else:
            measured = f"clearance is {min(known):.3g} rms: the rule says nothing here"
            found.append(Finding(claim, curve.label, measured, "not checked"))
    return found


def _better(first: str, second: str, curve: CurveFound, of: Observable) -> Finding:
    claim = f"{first} theory better than {second}"
    a, b = _distance(curve, of, first), _distance(curve, of, second)
    if a is None or b is None:
        missing = first if a is None else second
        return Finding(claim, curve.label, f"no answer of the {missing} theory", "not checked")
    measured = f"L1 {a[0]:.4f} ± {a[1]:.4f} against {b[0]:.4f} ± {b[1]:.4f}"
    return Finding(claim, curve.label, measured, _verdict(_less(*a, *b)))


def _acceptable(claim: str, name: str, curve: CurveFound, of: Observable) -> Finding:
    found = _distance(curve, of, name)
    if found is None:
        return Finding(claim, curve.label, f"no answer of the {name} theory", "not checked")
    measured = f"L1 to the full system {found[0]:.4f} ± {found[1]:.4f}"
    return Finding(claim, curve.label, measured, _verdict(_below(*found, ACCEPTABLE_L1)))


def _distance(curve: CurveFound, of: Observable, name: str) -> tuple[float, float] | None:
    """L1 of a theory to the full system, and how far chance and solvers may have moved it."""
    densities = curve.densities(of)
    theory, reference = theory_of(densities, name), reference_of(densities)
    if theory is None or reference is None:
        return None
    return distance_between(theory, reference)


def _less(a: float, slack_a: float, b: float, slack_b: float) -> bool | None:
    """Whether a < b; None where the difference does not exceed what both may be off."""
    return None if abs(a - b) <= slack_a + slack_b else a < b


def _below(value: float, slack: float, limit: float) -> bool | None:
    return None if abs(value - limit) <= slack else value < limit


def _verdict(holds: bool | None) -> Verdict:
    return "undecided" if holds is None else "holds" if holds else "does not hold"


def _kurtosis(density: AnyDensity) -> float:
    m1, m2, m3, m4 = (moment(density, k) for k in (1, 2, 3, 4))
    fourth = m4 - 4.0 * m1 * m3 + 6.0 * m1**2 * m2 - 3.0 * m1**4
    return fourth / (m2 - m1 * m1) ** 2 - 3.0


def _gaussian_density(density: AnyDensity, mean: float, variance: float) -> Density:
    reach = 9.0 * np.sqrt(variance)
    nodes = np.unique(np.append(density.panels[0], [mean - reach, mean + reach]))

    def pdf(x: Array) -> Array:
        return np.asarray(np.exp(-0.5 * (x - mean) ** 2 / variance) / np.sqrt(2 * np.pi * variance))

    return Density(
        density.observable, (nodes,), pdf, np.zeros_like, 0.0, Certificate(0.0, 0.0, 0.0, 0.0)
    )
