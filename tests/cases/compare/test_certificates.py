"""Certificates and densities are made in one place, and every route can say "not certified"."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cases.compare.routes import all_routes, method_for
from fpk.answer.certificate import Measured, certify
from fpk.answer.dynamics import Curve, Transient
from fpk.answer.method import ROUTES
from fpk.answer.names import parse_observable
from fpk.system.contact import Contact
from fpk.system.system import System

STOPS = tuple(Contact(mass, "both", 10.0, 0.5) for mass in (1, 2))
STIFF = System([1, 1], [1, 1e6], [0.1, 0.1], [0.05, 0.05], contacts=STOPS)
LINEAR = System([1, 1], [1, 1e6], [0.1, 0.1], [0.05, 0.05])
ONE_MASS = System([1.0], [1.0], [0.2], [0.1])
STOPPED = System([1, 1], [1, 1], [0.2, 0.2], [0.1, 0.1], contacts=STOPS[1:])
UNEQUAL = System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02], contacts=STOPS[1:])

TIGHT = {"tol": 1e-12}
"""Springs in a ratio of 1e6 leave 1e-12 of round-off: more than it allows."""
ENERGY_SAMPLE = {"paths": 256, "time": 0.5, "tol": 1e-4}
SAMPLE = {"paths": 4096, "relaxations": 1.0, "tol": 1e-5, "longest": 0.01}
SOLVERS = ("closed-form", "quadrature", "fem", "scikit-fem")
FAILING = {
    ("exact", "closed-form"): (STIFF, "H", TIGHT),
    ("linear", "closed-form"): (LINEAR, "H", TIGHT),
    **{("nonintegrable", solver): (STIFF, "H", TIGHT) for solver in SOLVERS},
    **{("integrable", solver): (LINEAR, "H1", TIGHT) for solver in SOLVERS},
    # Unequal temperatures beside a stop: six digits are out of reach.
    ("phase-space", "hermite"): (UNEQUAL, "q2", {"tol": 1e-9, "work": 2e10}),
    # A sample that is too small for the tolerance.
    ("nonintegrable", "simulation"): (ONE_MASS, "H", ENERGY_SAMPLE),
    ("integrable", "simulation"): (ONE_MASS, "H1", ENERGY_SAMPLE),
    ("montecarlo", "simulation"): (STOPPED, "q1", SAMPLE),
}


@pytest.mark.parametrize("name", ["certificate", "density"])
def test_certificates_and_densities_are_made_in_one_place(name):
    root, call = Path(__file__).parents[3], re.compile(rf"(?<!class )\b{name.capitalize()}\(")
    rooms = ("fpk", "averaging", "sim", "cases")
    texts = {
        p: p.read_text(encoding="utf-8") for room in rooms for p in (root / room).rglob("*.py")
    }
    assert len(texts) > 100
    found = {path.relative_to(root).as_posix() for path, text in texts.items() if call.search(text)}
    assert found == {f"fpk/answer/{name}.py"}


def test_every_route_is_made_to_fail():
    assert {(r.method, r.solver) for r in all_routes()} == set(FAILING) == set(ROUTES)


@pytest.mark.parametrize("key", FAILING, ids="/".join)
def test_a_route_that_misses_the_tolerance_says_so(key):
    system, observable, settings = FAILING[key]
    method = method_for(*key, **settings)
    (density,) = method.solve(system, [parse_observable(observable, system.n)]).densities
    assert not density.certificate.certified
    assert any("exceeds the tolerance" in words for words in density.certificate.failures)


def test_a_density_below_zero_is_not_certified_unless_its_error_allows_it():
    negative = Measured(0.0, 0.0, -1e-3, 0.0, 0.0)
    (words,) = certify(negative, tol=1e-9).failures
    assert "falls to -0.001 of its maximum" in words
    assert certify(replace(negative, absolute_error=1e-3), tol=1e-9).certified


@pytest.mark.parametrize("column", [0, 1])
def test_what_is_no_number_is_not_certified(column):
    good = certify(Measured(0.0, 0.0, 0.0, 0.0, 0.0), tol=1e-9)
    values = np.zeros((2, 1, 3))
    curve = Curve(values[0, 0], values[1, 0], good)
    transient = Transient(np.ones(1), *values, "numerical", good)
    assert curve.certificate.certified and transient.certificate.certified
    values[column, 0, 1] = np.nan
    curve = Curve(values[0, 0], values[1, 0], good)
    transient = Transient(np.ones(1), *values, "numerical", good)
    for answer in (curve, transient):
        assert answer.certificate.failures == ("1 of the values and errors are not numbers",)
