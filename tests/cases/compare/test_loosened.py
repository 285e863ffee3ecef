"""Default tolerances that are missed: asked again only looser, and only for that reason."""

from math import inf, nan

import pytest

from cases.compare.attempts import LOOSEST, loosened
from fpk.answer.certificate import Measured, certify


def asked(error, default, *, least=0.0, failures=()):
    """The tolerances at which a solver of this error was asked, and what came of it."""
    tols = []

    def ask(tol):
        tols.append(tol)
        wanted = tol or default
        # A solver that is content with a tenth of what it is asked for, and reaches ``error``.
        measured = Measured(max(error, least * wanted), 0.0, 0.0, 0.0, 0.0, failures=failures)
        return certify(measured, tol=wanted)

    answer, note = loosened(ask, lambda certificate: [certificate])
    stated = note.removeprefix("certified to ").partition(",")[0]
    return tols, answer.certified, float(stated) if note else None


def test_an_answer_that_meets_its_default_is_asked_once():
    assert asked(1e-11, 1e-10) == ([None], True, None)


@pytest.mark.parametrize(("error", "tol"), [(1.2e-10, 1e-9), (3e-7, 1e-6), (9e-5, 1e-4)])
def test_a_miss_is_asked_again_at_the_least_power_of_ten_that_its_error_meets(error, tol):
    assert asked(error, 1e-10) == ([None, pytest.approx(tol)], True, pytest.approx(tol))


@pytest.mark.parametrize("default", [1e-10, 1e-8, 1e-6, 1e-5])
@pytest.mark.parametrize("error", [2e-10, 3e-8, 4e-6, 5e-5, 0.3, nan, inf])
@pytest.mark.parametrize("failures", [(), ("the mesh is too large",)])
@pytest.mark.parametrize("least", [0.0, 1.5])
def test_tolerances_only_grow_up_to_the_loosest(default, error, failures, least):
    (first, *later), certified, tol = asked(error, default, least=least, failures=failures)
    rising = [default, *later]
    assert first is None and all(a < b for a, b in zip(rising, later, strict=False))
    assert all(t <= LOOSEST * (1.0 + 1e-12) for t in later)
    # Without a missed tolerance there is nothing that a looser one could mend.
    assert later or certified or not error > default or error > LOOSEST or error != error
    assert (tol is not None) == (certified and bool(later))


def test_an_answer_that_fails_for_another_reason_is_not_asked_again():
    assert asked(1e-12, 1e-5, failures=("the mesh is too large",)) == ([None], False, None)
