"""Claims of a source compared with numbers: findings about it, never failures of the program."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.special import ndtr

from cases.compare.answers import Answers
from cases.compare.compare import distance_between
from cases.compare.doubt import ACCEPTABLE_L1
from cases.scene.expect import RELATIONS, Expect
from cases.scene.questions import PassageQuestion
from cases.scene.written import with_error
from fpk.answer.contacts import stop_clearances
from fpk.answer.density import AnyDensity, distance_with_error
from fpk.answer.names import Observable, observable_name
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import Array

Verdict = Literal["holds", "does not hold", "undecided", "not checked"]

ALMOST_L1 = 0.05
"""Largest L1 distance of an almost Gaussian density to the fitted Gaussian: no probability is wrong
by more than 2.5 %, about the width of a printed line."""

ALMOST_KURTOSIS = 0.3
"""Largest |excess kurtosis| of an almost Gaussian density, a tenth of the Gaussian's 3. A density
that exceeds this or ``ALMOST_L1`` is non-Gaussian."""


@dataclass(frozen=True)
class Finding:
    """One claim on one curve, or on two neighbours, the measured numbers in words, and the verdict.

    It is "holds", "does not hold", "undecided" within the errors, or "not checked" without answers.
    """

    claim: str
    curve: str
    measured: str
    verdict: Verdict


@dataclass(frozen=True)
class Shape:
    """L1 distance to the Gaussian of equal mean and variance; ``kurtosis`` is the excess over 3."""

    l1: float
    l1_error: float
    kurtosis: float
    kurtosis_error: float

    @property
    def almost_gaussian(self) -> bool | None:
        """Whether l1, |kurtosis| are below ``ALMOST_L1``, ``ALMOST_KURTOSIS``; None: undecided."""
        near = {
            _below(self.l1, ALMOST_L1, self.l1_error),
            _below(abs(self.kurtosis), ALMOST_KURTOSIS, self.kurtosis_error),
        }
        return False if False in near else None if None in near else True


def findings(expect: Expect | None, curves: Sequence[Answers]) -> Iterator[Finding]:
    """Yield the finding on every claim of ``expect``, for every curve to which it applies."""
    if expect is None:
        return
    of, symbol = expect.of, curves[0].label.partition(" =")[0]
    for wanted, values, words in (
        (False, expect.non_gaussian, "non-Gaussian"),
        (True, expect.almost_gaussian, "almost Gaussian"),
    ):
        if values is None:
            continue
        relation, bound = values
        sign, holds = RELATIONS[relation]
        for curve in curves:
            if curve.value is None or not holds(curve.value, bound):
                continue
            claim = f"{observable_name(of)} {words} for {symbol} {sign} {bound:g}"
            if (density := _reference(curve, of)) is None:
                yield Finding(claim, curve.label, "no answer for the full system", "not checked")
                continue
            shape = shape_of(density)
            measured = f"L1 to the fitted Gaussian {shape.l1:.3f}"
            measured += f", excess kurtosis {shape.kurtosis:+.3f}"
            almost = shape.almost_gaussian
            verdict = _verdict(None if almost is None else almost == wanted)
            yield Finding(claim, curve.label, measured, verdict)
    if (direction := expect.nonintegrable_better_with) is not None:
        # Neighbours along the varied number, the better one last.
        claim = f"nonintegrable better with {direction} {symbol}"
        ordered = sorted(curves, key=lambda c: c.value or 0.0, reverse=direction == "smaller")
        for worse, better in pairwise(ordered):
            pair = [_distance(c, of, "nonintegrable") for c in (better, worse)]
            yield _nearer(claim, f"{worse.label} to {better.label}", *pair)
    limit = ACCEPTABLE_L1, 0.0
    for curve in curves:
        if expect.better is not None:
            pair = [_distance(curve, of, theory) for theory in expect.better]
            yield _nearer("{} better than {}".format(*expect.better), curve.label, *pair)
        if (rule := expect.clearance_rule) is not None:
            yield _clearance_rule(curve, rule, _distance(curve, of, "integrable"))
        for name in expect.acceptable:
            yield _nearer(f"{name} acceptable", curve.label, _distance(curve, of, name), limit)


def _clearance_rule(curve: Answers, rule: float, distance: tuple[float, float] | None) -> Finding:
    """Return the finding that modal averaging is acceptable if all clearances exceed ``rule`` rms.

    If one does not, the finding is on the converse: not acceptable. ``distance`` is its L1 distance
    to the full system and the error; None, no stop or an unknown rms: not checked.
    """
    stops = curve.system.fact(stop_clearances)
    ratios = [stop.ratio for stop in stops if stop.ratio is not None]
    claim = f"integrable acceptable for clearance > {rule:g} rms"
    if len(ratios) < max(len(stops), 1):
        return Finding(claim, curve.label, "the rms is not known", "not checked")
    found = _nearer(claim, curve.label, distance, (ACCEPTABLE_L1, 0.0))
    verdict, ratio = found.verdict, min(ratios)
    if ratio <= rule:  # the rule itself says nothing here
        claim = f"converse of the rule: not acceptable for clearance ≤ {rule:g} rms"
        opposite: dict[Verdict, Verdict] = {"holds": "does not hold", "does not hold": "holds"}
        verdict = opposite.get(verdict, verdict)
    return Finding(claim, curve.label, f"clearance {ratio:.3g} rms, {found.measured}", verdict)


def shape_of(density: AnyDensity) -> Shape:
    """Return excess kurtosis and L1 distance to the Gaussian of the same mean and variance.

    ``density`` is of one coordinate. The mass of the Gaussian outside of the support is included.
    Errors of a sample: ∫ standard error, and three standard errors of the kurtosis.
    """
    mean, scale, kurtosis = density.mean().value, density.std().value, density.kurtosis()
    (nodes,), excess = density.panels, kurtosis.value - 3.0
    shares = np.diff(ndtr((nodes - mean) / scale))
    if isinstance(density, SampledDensity):
        shares -= density.values * np.diff(nodes)
        distance = float(np.sum(np.abs(shares)) + abs(np.sum(shares)))
        chance = float(np.sum(density.standard_error * np.diff(density.edges[0])))
        return Shape(distance, chance, excess, 3.0 * kurtosis.error)

    def gaussian(x: Array) -> Array:
        return np.asarray(np.exp(-0.5 * ((x - mean) / scale) ** 2) / (np.sqrt(2.0 * np.pi) * scale))

    distance, error = distance_with_error(density, replace(density, pdf=gaussian))
    distance += 1.0 - float(np.sum(shares))
    return Shape(distance, 2.0 * density.l1_error + error, excess, kurtosis.error)


def _reference(curve: Answers, of: Observable) -> AnyDensity | None:
    """Return the full system's density of least L1 error, certified if any is; None without any."""
    full = (d for route, d in curve.densities(of).items() if route.solves == "full")
    return min(full, key=lambda d: (not d.certificate.certified, d.l1_error), default=None)


def _nearer(
    claim: str, where: str, near: tuple[float, float] | None, far: tuple[float, float] | None
) -> Finding:
    """Return the finding whether the L1 distance ``near`` (value, error) is smaller than ``far``.

    ``where`` is the label of the curve. Undecided within the sum of the errors; not checked if one
    distance is None.
    """
    if near is None or far is None:
        return Finding(claim, where, "no answer to compare with", "not checked")
    measured = f"L1 {with_error(*near)} against {with_error(*far)}"
    return Finding(claim, where, measured, _verdict(_below(near[0], far[0], near[1] + far[1])))


def _distance(curve: Answers, of: Observable, name: str) -> tuple[float, float] | None:
    """Return the L1 distance of the averaged method ``name`` to the full system, and its error.

    The error is by chance and solvers. None if the method has no density by functions, or the full
    system none at all.
    """
    own = (d for r, d in curve.densities(of).items() if r.method == name and not r.sampled)
    theory, reference = next(own, None), _reference(curve, of)
    if theory is None or reference is None:
        return None
    return distance_between(theory, reference)[:2]


def time_findings(curves: Sequence[Answers]) -> Iterator[Finding]:
    """Yield the finding on every claim of a [[passage]], undecided within two errors, by curve."""
    for curve in curves:
        for replies in curve.passages:
            question = replies.question
            assert isinstance(question, PassageQuestion)
            # Differences of the solved averaged equation to the full system.
            wanted = "averaging", "relative", question.theory
            own = [c for c in replies.comparisons if (c.measures, c.norm, c.a.method) == wanted]
            for what, values in (
                ("failure rate", question.rate_error),
                ("P(T ≤ t)", question.failure_error),
            ):
                if values is None:
                    continue
                relation, limit = values
                sign, holds = RELATIONS[relation]
                claim = (
                    f"{question.name}: averaging error of the {what} by the {question.theory}"
                    f" theory {sign} {limit:g}"
                )
                of = f"{question.name}: {what.removesuffix('t)')}"
                known = [c for c in own if c.observable.startswith(of)]
                if not known:
                    yield Finding(claim, curve.label, "no answer to compare with", "not checked")
                    continue
                c = min(known, key=lambda c: c.error)
                measured = f"relative {with_error(c.L1, c.error)}, {c.a.label} against {c.b.label}"
                undecided = abs(c.L1 - limit) <= 2.0 * c.error
                verdict = _verdict(None if undecided else holds(c.L1, limit))
                yield Finding(claim, curve.label, measured, verdict)


def _below(value: float, limit: float, slack: float) -> bool | None:
    """Whether value < limit; None if they differ by no more than their joint error ``slack``."""
    return None if abs(value - limit) <= slack else value < limit


def _verdict(holds: bool | None) -> Verdict:
    return "undecided" if holds is None else "holds" if holds else "does not hold"
