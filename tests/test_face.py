"""``import fpk``: the face, what it loads, what it says of mistakes, what can be pickled."""

import pickle
import subprocess
import sys

import numpy as np
import pytest
from systems import both, fig6

import fpk
from fpk.answer.density import Density

SYSTEM = fig6(both(10.0))


def python(code, folder):
    return subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False
    )


def test_import_loads_nothing_heavy_and_systems_need_no_compiler(tmp_path):
    code = (
        "import fpk, sys; print(sorted({'numpy', 'scipy', 'numba', 'cases'} & set(sys.modules)));"
        "fpk.System, fpk.Contact, fpk.DampingTerm; print('numba' in sys.modules)"
    )
    done = python(code, tmp_path)
    assert done.stdout.split() == ["[]", "False"], done.stderr


def test_every_name_of_the_face_is_there():
    for name in fpk.__all__:
        assert getattr(fpk, name) is not None
        assert name in dir(fpk)
    with pytest.raises(AttributeError, match="it has Contact, DampingTerm"):
        fpk.nothing  # noqa: B018


@pytest.mark.parametrize("hidden", ["sim.py", "averaging/__init__.py"])
def test_a_file_that_hides_a_room_is_named_in_one_line(tmp_path, hidden):
    path = tmp_path / hidden
    path.parent.mkdir(exist_ok=True)
    path.write_text("")
    last = python("import fpk; fpk.solve", tmp_path).stderr.strip().splitlines()[-1]
    room = hidden.split("/")[0].removesuffix(".py")
    assert f"hides the package {room} of vibro-fpk" in last and str(path) in last


def test_one_method_gives_a_density_that_can_be_called():
    answers = fpk.solve(SYSTEM, ["q2", "H"], methods=["nonintegrable/closed-form"])
    assert isinstance(answers["q2"], Density)
    assert answers["q2"](0.3).shape == ()
    assert answers["q2"]([0.0, 0.3]).shape == (2,)
    assert answers["q2"] is answers["q2", "nonintegrable/closed-form"]
    assert set(answers) == {(o, "nonintegrable/closed-form") for o in ("q2", "H")}
    assert len(answers) == 2


def test_without_methods_every_deterministic_route_is_tried():
    answers = fpk.solve(SYSTEM, ["q2", "H1"])
    assert not any(result.method.route.sampled for result in answers.results)
    assert "nonintegrable/fem" in answers.of("q2")
    assert "integrable/fem" in answers.of("H1")
    assert "(8)" in answers.refusals["exact"]
    assert "linear" in answers.refusals
    with pytest.raises(KeyError, match="say by which method"):
        answers["q2"]
    with pytest.raises(KeyError, match="there are densities of"):
        answers["p1"]


@pytest.mark.parametrize(
    ("request_", "error", "words"),
    [
        ({"observables": ["q3"]}, fpk.InvalidInput, "q1..q2"),
        ({"observables": "q2"}, fpk.InvalidInput, "must be a list"),
        ({"methods": ["exakt"]}, fpk.InvalidInput, "use one of"),
        ({"methods": ["nonintegrable/exact"]}, fpk.InvalidInput, "nonintegrable/fem"),
        ({"methods": "exact"}, fpk.InvalidInput, "must be a list"),
        ({"system": "fig6a"}, fpk.InvalidInput, "must be a System, as fpk.load"),
        ({"observables": [3]}, fpk.InvalidInput, 'observable = 3: must be a name, as "q2"'),
        ({"observables": 3}, fpk.InvalidInput, "must be a list"),
        ({"methods": [3]}, fpk.InvalidInput, "method = 3: must be a name or a Method"),
        ({"methods": 3}, fpk.InvalidInput, "must be a list"),
        ({"methods": iter(["exact"])}, fpk.InvalidInput, "must be a list"),
        ({"methods": ["exact"]}, fpk.NotApplicable, "exact: the compatibility condition"),
        ({"methods": ["nonintegrable"], "observables": ["H2"]}, fpk.NotApplicable, "total energy"),
    ],
)
def test_mistakes_are_told_in_one_line(request_, error, words):
    defaults = {"system": SYSTEM, "observables": ["q2"], "methods": ["nonintegrable"]}
    with pytest.raises(error) as caught:
        fpk.solve(**(defaults | request_))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_records_print_short_and_can_be_pickled():
    answers = fpk.solve(SYSTEM, ["q2"], methods=["nonintegrable/closed-form"])
    for record in (SYSTEM, answers, answers["q2"], answers.results[0], SYSTEM.contacts[0]):
        assert len(repr(record).splitlines()) == 1 and len(repr(record)) < 120
    assert "q2" in repr(answers["q2"]) and "certified" in repr(answers["q2"])
    p, q = answers["q2"], np.linspace(-1.0, 1.0, 5)
    again = pickle.loads(pickle.dumps(p))  # examples/kept_answers.py keeps all answers
    np.testing.assert_array_equal(again.at(q), p.at(q))
    assert again.certificate == p.certificate
    by_hand = Density(p.observable, p.panels, p.pdf, p.pointwise, p.l1_error, p.certificate)
    with pytest.raises(TypeError, match="does not know what it follows from"):
        pickle.dumps(by_hand)
