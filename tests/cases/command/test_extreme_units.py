"""The command line where numbers span the range of double precision: no NaN, no NumPy warning."""

import json

import numpy as np
import pytest

SYSTEM = """\
title = "Extreme units"
source = "tests"

[system]
mass            = [{mass}]
stiffness       = [{stiffness}]
damping         = [{damping}]
noise_intensity = [{noise}]
"""
HUGE = {"mass": 1e60, "stiffness": 1e60, "damping": 1e60, "noise": 1e90}
TINY = {"mass": 1e-50, "stiffness": 1.0, "damping": 1e-30, "noise": 1e-60}
WEAK = {"mass": 1.0, "stiffness": 1.0, "damping": 1e-9, "noise": 1e-9}
NO_CLEARANCE = "[[contact]]\nmass = 1\nside = 'both'\nstiffness = 1e8\nclearance = 0.0\n"


@pytest.fixture
def answer(fpk, tmp_path):
    def ask(system, command, *options, contact="", solver="fem", method="nonintegrable"):
        path = tmp_path / "scene.toml"
        path.write_text(SYSTEM.format(**system) + contact)
        how = ["--method", method, "--solver", solver, "--json"]
        status, out, err = fpk(command, path, *how, *options)
        assert (status, err) == (0, "")
        return json.loads(out)

    return ask


@pytest.mark.parametrize("solver", ["closed-form", "quadrature", "fem"])
@pytest.mark.parametrize("system", [HUGE, TINY], ids=["huge", "tiny"])
def test_the_density_at_rest_is_that_of_its_limit(answer, system, solver):
    given = answer(system, "density", "--of", "H", "--at", "0", solver=solver)
    (p,), (error,) = given["density"], given["error"]
    # One mass without contact: p = e^(−H/θ)/θ with θ = D/c.
    assert abs(p - system["damping"] / system["noise"]) <= error < 1e-10 * p


@pytest.mark.parametrize("solver", ["closed-form", "fem"])
def test_the_density_at_rest_rises_as_that_of_its_limit(answer, solver):
    given = answer(HUGE, "transient", "--of", "H", "--times", "1,100", "--at", "0,1", solver=solver)
    p, error = np.array(given["density"]), np.array(given["error"])
    # From rest p = e^(−H/θ_t)/θ_t with θ_t = θ (1 − e^(−ct/m)).
    exact = -1e-30 / np.expm1(-np.array([[1.0], [100.0]]))
    assert np.all(np.abs(p - exact) <= error) and np.all(error < 1e-10 * exact)


@pytest.mark.parametrize("solver", ["closed-form", "fem"])
def test_no_clearance_makes_no_warning_at_rest(answer, solver):
    own = {"mass": 1.0, "stiffness": 1.0, "damping": 0.1, "noise": 0.05}
    given = answer(own, "density", "--of", "H", "--at", "0", contact=NO_CLEARANCE, solver=solver)
    assert given["density"][0] > 1e3 and given["error"][0] < 1e-6


def test_several_masses_are_hardly_ever_at_rest(fpk):
    for solver in ("closed-form", "quadrature", "fem"):
        how = ("--method", "nonintegrable", "--solver", solver, "--json")
        status, out, err = fpk("density", "fig6a", *how, "--of", "H", "--at", "0")
        assert (status, err) == (0, "") and json.loads(out)["density"] == [0.0]


def test_a_failure_rate_that_is_a_multiple_of_the_damping(answer):
    # 1F1(−1; 1; x) = 1 − x vanishes at x = c H/D = 1: the rate is c itself.
    given = answer(WEAK, "passage", "--limit", "H=1", method="integrable", solver="closed-form")
    assert abs(given["rate"] - 1e-9) <= given["rate_error"] < 1e-20


def test_times_far_below_and_beyond_all_scales(fpk):
    words = ("passage", "cir", "--method", "nonintegrable", "--solver", "fem", "--limit", "H=1.5")
    status, out, err = fpk(*words, "--times", "1e-50,1e50", "--json")
    assert (status, err) == (0, "")
    survival, error = (np.array(json.loads(out)[key]) for key in ("survival", "survival_error"))
    assert np.all(np.abs(survival - [1.0, 0.0]) <= error) and np.all(error < 1e-10)


def test_a_start_is_written_as_it_was_given(fpk):
    words = ("passage", "cir", "--method", "nonintegrable", "--limit", "H=1")
    _, out, _ = fpk(*words, "--start", "H=0.9999999999")
    assert "from H=0.9999999999 " in out
    status, _, err = fpk(*words, "--start", "H=1.0000000001")
    assert status == 2 and '"H=1.0000000001"' in err
