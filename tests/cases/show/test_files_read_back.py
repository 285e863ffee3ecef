"""netCDF as xarray reads it, and keys of JSON: names without commas, numbers as numbers."""

import json
import re

import numpy as np
import pytest
import xarray as xr

from cases.command.parts import with_plain_keys
from cases.show.digest import digest_of
from cases.show.fields import write_netcdf

VARIED = """
[vary]
contact.stiffness = [100.0, 0.5]

[units]
length = "mm"
mass   = "kg"
time   = "seconds"

[[passage]]
limit = "H=0.5"
times = [10.0, 20.0]

[[transient]]
of    = "H"
times = [5.0]
"""


@pytest.fixture(scope="module")
def outcome(solved, scene_text):
    text = scene_text.replace('"q2", "H"', '"q2", "H", "q2,p2"') + VARIED
    return solved(text, "nonintegrable/fem")


@pytest.fixture(scope="module")
def data(outcome, tmp_path_factory):
    path = tmp_path_factory.mktemp("out") / "result.nc"
    write_netcdf(outcome, path)
    with xr.open_dataset(path, engine="h5netcdf") as data:
        yield data.load()


def test_names_are_variables_and_curves_are_selected_by_the_number_that_varies(data, outcome):
    assert {"p_q2", "p_q2_p2", "error_q2_p2", "p_H"} <= set(data.data_vars)
    assert all(re.fullmatch(r"[A-Za-z]\w*", str(name), re.ASCII) for name in data.variables)
    assert data["curve"].values.tolist() == [0.5, 10.0, 100.0]
    assert data["curve"].attrs["long_name"] == "B"
    assert data["curve_label"].values.tolist() == ["B = 0.5", "B = 10", "B = 100"]
    assert "curve_label" in data["p_q2"].coords
    q = data["q2"].values
    for curve in outcome.curves:
        (p,) = curve.densities(outcome.scene.observables[0]).values()
        read = data["p_q2"].sel(curve=curve.value).values[0]
        np.testing.assert_array_equal(read, p.at(q)[0])
    assert float(data["p_q2"].sel(curve=60.0, method="nearest").curve) == 100.0
    # Every axis but the routes is of numbers.
    text = {name for name in data.indexes if data[name].dtype.kind not in "fi"}
    assert text and all(name.startswith("route_") for name in text)


def test_variables_say_their_units(data):
    units = {
        name: data[name].attrs["units"] for name in data.variables if "units" in data[name].attrs
    }
    assert units["q2"] == "mm" and units["p_q2"] == units["error_q2"] == "mm⁻¹"
    assert units["p2_of_q2_p2"] == "kg mm seconds⁻¹"
    assert units["H"] == "kg mm² seconds⁻²"
    # A plural would be read as a date.
    assert units["time_passage_1"] == units["mean_passage_1"] == "second"
    assert data["mean_passage_1"].dtype == data["time_passage_1"].dtype == float
    assert units["variance_passage_1"] == "seconds²" and units["rate_passage_1"] == "seconds⁻¹"
    assert units["survival_passage_1"] == "1" and units["at_transient_1"] == units["H"]
    assert data.attrs["units"] == "mm, kg, seconds"


@pytest.mark.parametrize(
    ("more", "curves"),
    [("", [0.0]), ("[vary]\nsystem.noise_intensity = [[0.02, 0.01]]\n", [0.0, 1.0])],
)
def test_a_lone_curve_has_the_number_0_and_those_of_one_number_are_counted(
    more, curves, solved, scene_text, tmp_path
):
    """The second has two matrices of one trace."""
    write_netcdf(solved(scene_text + more, "nonintegrable/closed-form"), tmp_path / "x.nc")
    with xr.open_dataset(tmp_path / "x.nc", engine="h5netcdf") as data:
        assert data["curve"].values.tolist() == curves
        units = "the scene's own consistent units"
        assert data.attrs["units"] == data["q2"].attrs["units"] == units


def test_every_curve_of_json_has_one_shape(outcome):
    digest = digest_of(outcome)
    first = {"label": "B = 10", "key": "contact.stiffness", "value": 10.0}
    assert {key: digest[key] for key in first} == first
    assert [curve["value"] for curve in digest["curves"]] == [100.0, 0.5]
    assert len({frozenset(curve) for curve in digest["curves"]}) == 1
    assert digest.keys() > digest["curves"][0].keys()
    plain = with_plain_keys(digest)
    assert json.dumps(plain, allow_nan=False).count("null") == json.dumps(digest).count("null")


def test_keys_are_plain_and_none_is_lost():
    record = {"E q1²": 1, "kT": 2, "L1": 3, "L1 error at the first time": [{"sampled by": 4}]}
    assert with_plain_keys(record) == {
        "mean_q1_squared": 1, "kt": 2, "L1": 3, "l1_error_at_the_first_time": [{"sampled_by": 4}]
    }  # fmt: skip
    assert with_plain_keys({"a b": 1, "a_b": 2}) == {"a b": 1, "a_b": 2}
