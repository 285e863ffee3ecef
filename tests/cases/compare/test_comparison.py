"""The comparison calls a right answer wrong as rarely as promised, and a wrong one wrong."""

from dataclasses import dataclass, replace
from math import inf, nan

import numpy as np
import pytest
from made_answers import gaussian, histogram

import fpk
from cases.compare.attempts import LOOSEST, loosen_tolerance
from cases.compare.compare import chance_l1, compare_densities, what_is_measured
from cases.compare.routes import register_routes
from fpk.answer.certificate import Measured, certify
from fpk.answer.density import l1_distance
from fpk.answer.method import ROUTES, Result, solvers_of

register_routes()


@dataclass(frozen=True)
class Named:
    name: str

    @property
    def route(self):
        return ROUTES[self.name, solvers_of(self.name)[0]]


def sample(seed):
    return histogram(seed, size=4000, bins=256)


def compare(a, b, *, names=("montecarlo", "exact"), exact=True, neglected=""):
    results = [
        Result(Named(n), (d,), neglected=neglected if n == "integrable" else "")
        for n, d in zip(names, (a, b), strict=True)
    ]
    (comparison,) = compare_densities(results, averaging_is_exact=exact)
    return comparison


def symmetrised(density):
    """The histogram of x and −x together, batch by batch: bins of either sign are then equal."""
    values = density.batch_values + density.batch_values[:, ::-1]
    return replace(density, values=0.5 * values.mean(0), batch_values=0.5 * values)


@pytest.mark.parametrize("mirror", [False, True])
def test_chance_is_measured_as_it_is(mirror):
    """Mean and spread of the L1 distance over 200 samples are those the bootstrap of one states."""
    truth, seen = gaussian(), symmetrised if mirror else (lambda density: density)
    found = np.array([l1_distance(seen(sample(s)).joined(2), truth) for s in range(200)])
    mean, quantile = chance_l1(seen(sample(1000)).joined(2))
    assert mean == pytest.approx(found.mean(), rel=0.1)
    assert found.max() < quantile < 2 * found.mean()


def test_samples_are_held_to_chance_solvers_to_their_estimates_and_averaging_to_nothing():
    right, wrong = compare(sample(7), gaussian()), compare(sample(7), gaussian(1.03))
    assert right.measures == "sampling" and right.holds
    assert not wrong.holds and wrong.band < wrong.L1
    names = ("nonintegrable", "nonintegrable")
    assert compare(gaussian(), gaussian(1 + 1e-13), names=names).holds
    assert not compare(gaussian(), gaussian(1 + 1e-9), names=names).holds
    assert compare(gaussian(l1_error=0.0), gaussian(l1_error=0.0), names=names).holds
    names = ("montecarlo", "nonintegrable")
    averaged = compare(sample(7), gaussian(1.5), names=names, exact=False)
    assert averaged.measures == "averaging" and averaged.band is None and averaged.holds
    assert 0 < averaged.error < averaged.L1


def test_what_left_contacts_out_is_not_held_to_the_exact_density():
    """With contacts the exact theory may apply, and the integrable one is still another."""
    names, left_out = ("exact", "integrable"), "2 stops"
    assert compare(gaussian(), gaussian(1.5), names=names).measures == "numerical"
    comparison = compare(gaussian(), gaussian(1.5), names=names, neglected=left_out)
    assert comparison.measures == "averaging" and comparison.holds and comparison.band is None
    others = compare(gaussian(), gaussian(), names=("exact", "nonintegrable"), neglected=left_out)
    assert others.measures == "numerical"


@pytest.mark.parametrize(
    ("a", "b", "coincide", "expected"),
    [
        ("nonintegrable", "nonintegrable", False, "numerical"),
        ("exact", "linear", True, "numerical"),
        ("nonintegrable", "exact", True, "numerical"),
        ("nonintegrable", "linear", False, "averaging"),
        ("nonintegrable", "montecarlo", False, "averaging"),
        ("nonintegrable", "montecarlo", True, "sampling"),
        ("linear", "montecarlo", False, "sampling"),
        ("integrable", "integrable", False, "numerical"),
        ("integrable", "nonintegrable", False, "averaging"),
        ("integrable", "nonintegrable", True, "numerical"),
    ],
)
def test_which_error_a_pair_measures(a, b, coincide, expected):
    a, b = Named(a).route, Named(b).route
    assert what_is_measured(a, b, averaging_is_exact=coincide) == expected
    assert what_is_measured(b, a, averaging_is_exact=coincide) == expected


def test_a_comparison_is_one_line_of_text():
    answers = fpk.solve(fpk.load("fig6a").system, ["q2"], methods=["nonintegrable", "integrable"])
    (comparison,) = fpk.compare(answers)
    assert str(comparison) == (
        f"q2, nonintegrable/fem and integrable/closed-form: averaging, L1 = {comparison.L1:.4g}"
        f" ± {comparison.error:.1g}, reported"
    )
    judged = replace(comparison, measures="numerical", band=0.25, error=0.0)
    assert str(judged).endswith("± 0, allowed 0.25")


def asked(error, default, *, least=0.0, failures=()):
    """The tolerances at which a solver of this error was asked, and what came of it.

    It is content with ``least`` of what it is asked for.
    """
    tols = []

    def ask(tol):
        tols.append(tol)
        reached = max(error, least * (tol or default))
        measured = Measured(reached, 0.0, 0.0, 0.0, 0.0, failures=failures)
        return certify(measured, tol=tol or default)

    answer, note = loosen_tolerance(ask, lambda certificate: [certificate])
    stated = note.removeprefix("certified to ").partition(",")[0]
    return tols, answer.certified, float(stated) if note else None


@pytest.mark.parametrize(("error", "tol"), [(1.2e-10, 1e-9), (3e-7, 1e-6), (9e-5, 1e-4)])
def test_a_miss_is_asked_again_at_the_least_power_of_ten_that_its_error_meets(error, tol):
    assert asked(error, 1e-10) == ([None, pytest.approx(tol)], True, pytest.approx(tol))
    # An answer that meets its default or fails for another reason is asked once.
    assert asked(error, 1e-3) == ([None], True, None)
    assert asked(error, 1e-3, failures=("the mesh is too large",)) == ([None], False, None)
    # Tolerances grow up to the loosest, for a solver that always misses what it is asked for.
    (first, *later), certified, stated = asked(error, 1e-10, least=1.5)
    assert first is stated is None and not certified and later == sorted(set(later))
    assert later[-1] == pytest.approx(LOOSEST)


@pytest.mark.parametrize("error", [0.3, nan, inf])
def test_what_no_tolerance_that_is_allowed_meets_is_asked_once(error):
    assert asked(error, 1e-10) == ([None], False, None)
