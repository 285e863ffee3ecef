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
from cases.show.text import render

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


BYTES = st.one_of(
    st.binary(max_size=300),
    st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass")),
    st.text("[]{}=.,\"'#\\\n ab1-_", max_size=60).map(str.encode),
)


@pytest.mark.parametrize("count", [150, pytest.param(3000, marks=pytest.mark.slow)])
def test_any_bytes_are_refused(count, tmp_path):
    @examples(count)
    @given(content=BYTES)
    def refused(content):  # a scene does not come about by chance
        assert loaded_or_refused(tmp_path / "any.toml", content) is None

    refused()


@pytest.mark.parametrize("count", [350, pytest.param(7000, marks=pytest.mark.slow)])
def test_any_mutation_of_a_shipped_scene_loads_or_is_refused(count, tmp_path):
    @examples(count)
    @given(content=mutated_scenes())
    def loads_or_is_refused(content):
        scene = loaded_or_refused(tmp_path / "any.toml", content)
        if scene is not None:
            assert scene.text.encode() == content.removeprefix("\ufeff".encode())
            assert scene.curves and scene.observables and scene.system.n >= 1

    loads_or_is_refused()


SLOW = pytest.mark.slow
ANY_UNITS = {"units": 6, "spread": 2}


@pytest.mark.parametrize(
    ("count", "kind"), [(20, {"one_law": True}), pytest.param(200, ANY_UNITS, marks=SLOW)]
)
def test_a_valid_scene_loads_and_is_shown(count, kind, tmp_path):
    """The record of ``fpk show`` is JSON without NaN."""

    @examples(count)
    @given(text=valid_scenes(**kind))
    def shown(text):
        scene = loaded_or_refused(tmp_path / "any.toml", text.encode())
        assert scene is not None and scene.text == text
        assert scene.system.mass.tolist() == tomllib.loads(text)["system"]["mass"]
        record = show_record(scene)
        json.dumps(record, allow_nan=False)
        assert render("show.txt", record)
        assert "nan" not in json.dumps(record["natural_frequencies"])

    shown()


@pytest.mark.parametrize(
    ("count", "kind"),
    [
        (15, {"most_masses": 2, "one_law": True}),
        pytest.param(100, ANY_UNITS, marks=SLOW),
    ],
)
def test_a_valid_scene_runs(count, kind, tmp_path):
    @examples(count)
    @given(text=valid_scenes(most_touching=1, **kind))
    def runs(text):
        for problem in problems_of_run(tmp_path / "any.toml", text):
            # Only modal averaging has modal energies, and it is refused at resonance.
            refused = (
                problem.startswith("no route applies: ") and "; internal resonance: " in problem
            )
            # Far scales may be refused or not be certified; no two routes differ and none fails.
            far = "no route applies" in problem or "is not certified: " in problem
            assert refused or (kind is ANY_UNITS and far and "differ" not in problem)

    runs()


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
