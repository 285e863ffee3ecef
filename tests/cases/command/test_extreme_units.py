"""The command line where numbers span the range of double precision: no NaN, no NumPy warning."""

import numpy as np
import pytest
from systems import ONE_MASS

HUGE, TINY = (1e60, 1e60, 1e60, 1e90), (1e-50, 1.0, 1e-30, 1e-60)
AT_REST = ("density", "--of", "H", "--at", 0)
NO_CLEARANCE = "[[contact]]\nmass = 1\nside = 'both'\nstiffness = 1e8\nclearance = 0.0\n"
STOP = "[[contact]]\nmass = 1\nside = 'right'\nlaw = 'power'\nexponent = 2.0\n"


@pytest.fixture
def given(answer, written):
    def ask(text, command, *options, solver="fem", method="nonintegrable"):
        words = command, written(text), "--method", method, "--solver", solver, *options
        record = answer(*words)
        assert record["solver"] == solver
        return record

    return ask


@pytest.mark.parametrize("solver", ["closed-form", "quadrature", "fem"])
@pytest.mark.parametrize("system", [HUGE, TINY], ids=["huge", "tiny"])
def test_the_density_at_rest_is_that_of_its_limit(given, system, solver):
    record = given(ONE_MASS.format(*system), *AT_REST, solver=solver)
    (p,), (error,) = record["density"], record["error"]
    # One mass without contact: p = e^(−H/θ)/θ with θ = D/c.
    assert abs(p - system[2] / system[3]) <= error < 1e-10 * p


@pytest.mark.parametrize("solver", ["closed-form", "fem"])
def test_the_density_at_rest_rises_as_that_of_its_limit(given, solver, answer):
    asked = ("transient", "--of", "H", "--times", "1,100", "--at", "0,1")
    record = given(ONE_MASS.format(*HUGE), *asked, solver=solver)
    p, error = np.array(record["density"]), np.array(record["error"])
    # From rest p = e^(−H/θ_t)/θ_t with θ_t = θ (1 − e^(−ct/m)).
    exact = -1e-30 / np.expm1(-np.array([[1.0], [100.0]]))
    assert np.all(np.abs(p - exact) <= error) and np.all(error < 1e-10 * exact)
    plain = ONE_MASS.format(1.0, 1.0, 0.1, 0.05)
    record = given(plain + NO_CLEARANCE, *AT_REST, solver=solver)
    assert record["density"][0] > 1e3 and record["error"][0] < 1e-6
    # Several masses are hardly ever at rest.
    how = ("--method", "nonintegrable", "--solver", solver)
    assert answer("density", "fig6a", *how, *AT_REST[1:])["density"] == [0.0]


def test_rates_and_times_far_below_and_beyond_all_scales_and_starts_as_written(
    given, fpk, answer, refusal
):
    # 1F1(−1; 1; x) = 1 − x vanishes at x = c H/D = 1: the failure rate is c itself.
    weak = ONE_MASS.format(1.0, 1.0, 1e-9, 1e-9)
    record = given(weak, "passage", "--limit", "H=1", method="integrable", solver="closed-form")
    assert abs(record["rate"] - 1e-9) <= record["rate_error"] < 1e-20
    words = ("passage", "cir", "--method", "nonintegrable", "--limit")
    record = answer(*words, "H=1.5", "--times", "1e-50,1e50")
    survival, error = (np.array(record[key]) for key in ("survival", "survival_error"))
    assert np.all(np.abs(survival - [1.0, 0.0]) <= error) and np.all(error < 1e-10)
    assert "from H=0.9999999999 " in fpk(*words, "H=1", "--start", "H=0.9999999999")[1]
    assert '"H=1.0000000001"' in refusal(*words, "H=1", "--start", "H=1.0000000001")


def test_energies_whose_squares_overflow_are_answered_or_blamed_on_the_units(given, fpk, written):
    """The stop in the unit of the clearance, H in that of its square."""

    def far(stiffness, unit):
        system = ONE_MASS.format(1.0, 1.0, 1.0 / unit, unit)
        return f"{system}{STOP}stiffness = {stiffness}\nclearance = {unit}\n"

    first, second = (
        given(text, *AT_REST, solver="closed-form")["density"][0]
        for text in (far(1.0, 1e99), far(1e99, 1.0))
    )
    assert first * 1e198 == pytest.approx(second, rel=1e-11)
    for solver in ("fem", "quadrature"):
        how = ("--method", "nonintegrable", "--solver", solver)
        status, _, err = fpk("density", written(far(1.0, 1e99)), *how, *AT_REST[1:])
        assert status == 1 and err.count("\n") == 1
        assert "leave the range of double precision: choose other units" in err
