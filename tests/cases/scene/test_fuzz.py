"""Whatever is given as a scene: it loads and can be shown, or one line says what to do about it."""

import json
import re
import tomllib
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scenes_drawn import mutated_scenes, valid_scenes

from cases.compare.routes import method_for
from cases.compare.stationary import run_scene
from cases.scene.errors import LONGEST, BadInput
from cases.scene.scene import load_scene
from cases.show.facts import show_record
from cases.show.text import rendered

REFUSAL = re.compile(r".*/any\.toml: \S.*[:;] .*\S")
"""File, what is wrong, and after a colon or semicolon what to do."""


def examples(count):
    """Settings for ``count`` inputs, the same ones in every run."""
    return settings(
        max_examples=count,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )


def loaded_or_refused(path, content):
    """Return the scene in ``content``, or None where it is refused as it should be."""
    path.write_bytes(content)
    try:
        return load_scene(str(path))
    except BadInput as error:
        line = str(error)
    assert len(line) <= LONGEST and line.isprintable(), line
    assert REFUSAL.fullmatch(line), line
    return None


def assert_refused(path, content):
    assert loaded_or_refused(path, content) is None  # a scene does not come about by chance


def assert_loads_or_is_refused(path, content):
    scene = loaded_or_refused(path, content)
    if scene is not None:
        assert scene.text.encode() == content.removeprefix("\ufeff".encode())
        assert scene.curves and scene.observables and scene.system.n >= 1


BYTES = st.one_of(
    st.binary(max_size=300),
    st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass")),
    st.text("[]{}=.,\"'#\\\n ab1-_", max_size=60).map(str.encode),
)


@examples(150)
@given(content=BYTES)
def test_any_bytes_are_refused(content, tmp_path):
    assert_refused(tmp_path / "any.toml", content)


@examples(350)
@given(content=mutated_scenes())
def test_any_mutation_of_a_shipped_scene_loads_or_is_refused(content, tmp_path):
    assert_loads_or_is_refused(tmp_path / "any.toml", content)


@pytest.mark.slow
@examples(3000)
@given(content=BYTES)
def test_three_thousand_more_bytes(content, tmp_path):
    assert_refused(tmp_path / "any.toml", content)


@pytest.mark.slow
@examples(7000)
@given(content=mutated_scenes())
def test_seven_thousand_more_mutations(content, tmp_path):
    assert_loads_or_is_refused(tmp_path / "any.toml", content)


def shown(scene):
    """The record of ``fpk show`` is JSON without NaN, and text without anything unprintable."""
    record = show_record(scene)
    json.dumps(record, allow_nan=False)
    text = rendered("show.txt", record)
    assert "nan" not in json.dumps(record["natural_frequencies"])
    return text


@examples(20)
@given(text=valid_scenes(one_law=True))
def test_a_valid_scene_loads_and_is_shown(text, tmp_path):
    path = tmp_path / "any.toml"
    scene = loaded_or_refused(path, text.encode())
    assert scene is not None and scene.text == text
    given_back = tomllib.loads(text)["system"]
    assert scene.system.mass.tolist() == given_back["mass"]
    assert shown(scene)


@pytest.mark.slow
@examples(200)
@given(text=valid_scenes(units=6, spread=2))
def test_a_valid_scene_in_any_units_is_shown(text, tmp_path):
    scene = loaded_or_refused(tmp_path / "any.toml", text.encode())
    assert scene is not None and shown(scene)


@examples(15)
@given(text=valid_scenes(most_masses=2, most_touching=1, one_law=True))
def test_a_valid_scene_runs(text, tmp_path):
    # Only modal averaging has modal energies, and it is refused at resonance.
    for problem in problems_of_run(tmp_path / "any.toml", text):
        assert problem.startswith("no route applies: ") and "; internal resonance: " in problem


@pytest.mark.slow
@examples(100)
@given(text=valid_scenes(units=6, spread=2, most_touching=1))
def test_a_valid_scene_in_any_units_runs(text, tmp_path):
    # Far scales may be refused or not be certified; no two routes differ and none fails.
    for problem in problems_of_run(tmp_path / "any.toml", text):
        assert "no route applies" in problem or "is not certified: " in problem
        assert "differ" not in problem


def problems_of_run(path, text):
    """Problems of a run by the routes in closed form; each route answers or says why not.

    Not every density has to be given, as these are few of the routes.

    The tolerance is a hundred times that of the methods: no scene of ordinary numbers misses it.
    """
    scene = loaded_or_refused(path, text.encode())
    methods = [
        method_for(*route, tol=1e-8)
        for route in [("exact",), ("linear",), ("nonintegrable", "closed-form"), ("integrable",)]
    ]
    outcome = run_scene(replace(scene, densities_asked=False), methods)
    for curve in outcome.curves:
        assert curve.results or curve.refused
        for result in curve.results:
            for density in result.densities:
                certificate = density.certificate
                assert certificate.certified == (not certificate.failures)
        assert all(r.reason for r in curve.refused)
    return outcome.problems
