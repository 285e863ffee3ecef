"""The command line where numbers span the range of double precision: no NaN, no NumPy warning."""

import json

import numpy as np
import pytest

SYSTEM = """\
[system]
mass            = [{mass}]
stiffness       = [{stiffness}]
damping         = [{damping}]
noise_intensity = [{noise}]
"""
HUGE = {"mass": 1e60, "stiffness": 1e60, "damping": 1e60, "noise": 1e90}
TINY = {"mass": 1e-50, "stiffness": 1.0, "damping": 1e-30, "noise": 1e-60}
WEAK = {"mass": 1.0, "stiffness": 1.0, "damping": 1e-9, "noise": 1e-9}
PLAIN = {"mass": 1.0, "stiffness": 1.0, "damping": 0.1, "noise": 0.05}
NO_CLEARANCE = "[[contact]]\nmass = 1\nside = 'both'\nstiffness = 1e8\nclearance = 0.0\n"
STOP = "[[contact]]\nmass = 1\nside = 'right'\nlaw = 'power'\nexponent = 2.0\n"
AT_REST = ("density", "--of", "H", "--at", 0)


@pytest.fixture
def given(answer, written):
    def ask(system, command, *options, contact="", solver="fem", method="nonintegrable"):
        how = ["--method", method, "--solver", solver]
        return answer(command, written(SYSTEM.format(**system) + contact), *how, *options)

    return ask


@pytest.mark.parametrize("solver", ["closed-form", "quadrature", "fem"])
@pytest.mark.parametrize("system", [HUGE, TINY], ids=["huge", "tiny"])
def test_the_density_at_rest_is_that_of_its_limit(given, system, solver, answer):
    record = given(system, *AT_REST, solver=solver)
    (p,), (error,) = record["density"], record["error"]
    # One mass without contact: p = e^(−H/θ)/θ with θ = D/c.
    assert abs(p - system["damping"] / system["noise"]) <= error < 1e-10 * p
    # Several masses are hardly ever at rest.
    how = ("--method", "nonintegrable", "--solver", solver)
    assert answer("density", "fig6a", *how, *AT_REST[1:])["density"] == [0.0]


@pytest.mark.parametrize("solver", ["closed-form", "fem"])
def test_the_density_at_rest_rises_as_that_of_its_limit(given, solver):
    asked = ("transient", "--of", "H", "--times", "1,100", "--at", "0,1")
    record = given(HUGE, *asked, solver=solver)
    p, error = np.array(record["density"]), np.array(record["error"])
    # From rest p = e^(−H/θ_t)/θ_t with θ_t = θ (1 − e^(−ct/m)).
    exact = -1e-30 / np.expm1(-np.array([[1.0], [100.0]]))
    assert np.all(np.abs(p - exact) <= error) and np.all(error < 1e-10 * exact)
    record = given(PLAIN, *AT_REST, contact=NO_CLEARANCE, solver=solver)
    assert record["density"][0] > 1e3 and record["error"][0] < 1e-6


def test_a_failure_rate_that_is_a_multiple_of_the_damping(given):
    # 1F1(−1; 1; x) = 1 − x vanishes at x = c H/D = 1: the rate is c itself.
    record = given(WEAK, "passage", "--limit", "H=1", method="integrable", solver="closed-form")
    assert abs(record["rate"] - 1e-9) <= record["rate_error"] < 1e-20


def test_times_far_below_and_beyond_all_scales_and_starts_as_written(fpk, answer, refusal):
    words = ("passage", "cir", "--method", "nonintegrable", "--limit")
    record = answer(*words, "H=1.5", "--times", "1e-50,1e50")
    survival, error = (np.array(record[key]) for key in ("survival", "survival_error"))
    assert np.all(np.abs(survival - [1.0, 0.0]) <= error) and np.all(error < 1e-10)
    assert "from H=0.9999999999 " in fpk(*words, "H=1", "--start", "H=0.9999999999")[1]
    assert '"H=1.0000000001"' in refusal(*words, "H=1", "--start", "H=1.0000000001")


def far(stiffness, unit):
    """A scene with its stop in the unit of the clearance, H in that of its square."""
    system = SYSTEM.format(mass=1.0, stiffness=1.0, damping=1.0 / unit, noise=unit)
    return f"{system}{STOP}stiffness = {stiffness}\nclearance = {unit}\n"


@pytest.mark.parametrize("solver", ["fem", "quadrature"])
def test_energies_whose_squares_overflow_are_not_blamed_on_the_damping(solver, fpk, written):
    how = ("--method", "nonintegrable", "--solver", solver)
    status, _, err = fpk("density", written(far(1.0, 1e99)), *how, *AT_REST[1:])
    assert status == 1 and err.count("\n") == 1
    assert "leave the range of double precision: choose other units" in err


def test_the_closed_form_answers_at_energies_whose_squares_overflow(fpk, written):
    densities = []
    for text in (far(1.0, 1e99), far(1e99, 1.0)):
        how = ("--method", "nonintegrable", "--solver", "closed-form", "--json")
        status, out, _ = fpk("density", written(text), *how, *AT_REST[1:])
        assert status == 0
        densities.append(json.loads(out)["density"][0])
    assert densities[0] * 1e198 == pytest.approx(densities[1], rel=1e-11)
