"""The map of regimes: which theory is nearer, judged by what, and what is written and printed."""

import numpy as np
import xarray as xr

from cases.study.regime_map import winner_of

GRID = ["--vary", "contact.stiffness=0.01:100:log2", "--vary", "contact.clearance=0.5:2:2"]
QUICK = ["--paths", 4096, "--time", 30, "--seed", 3]


def test_the_nearer_theory_is_named_beyond_the_noise_only():
    assert winner_of({"a": (0.1, 0.01), "b": (0.2, 0.01)}) == "a"
    assert winner_of({"a": (0.2, 0.01), "b": (0.1, 0.01)}) == "b"
    assert winner_of({"a": (0.1, 0.01), "b": (0.115, 0.01)}) == "undecided"
    assert winner_of({"b": (0.1, 0.01)}) == "b" and winner_of({}) == "neither"


def test_a_map_by_simulation_is_written(answer, tmp_path):
    record = answer("regime", "fig6a", *GRID, *QUICK, "--out", tmp_path)
    assert (record["reused"], len(record["points"])) == (0, 4)
    winners = {tuple(p["values"]): p["winner"] for p in record["points"]}
    assert winners[0.01, 0.5] == winners[100.0, 2.0] == "integrable"
    assert winners[100.0, 0.5] == "nonintegrable"
    with xr.open_dataset(tmp_path / "regime.nc", engine="h5netcdf") as data:
        distance = data["value"][0]
        assert distance.shape == (2, 2, 2) and np.all(distance > 0)
        best = distance.sel(route="nonintegrable").sel({"contact.stiffness": 100}).values
        assert best[0] < best[1]
    assert (tmp_path / "regime.csv").read_text().count("\n") == 5


def test_the_equation_of_the_full_system_judges_where_it_is_asked_to(answer):
    grid = ["--vary", "contact.stiffness=0.1:0.2:2", "--reference", "phase-space", *QUICK]
    points = answer("regime", "fig6a", *grid)["points"]
    assert {p["reference"] for p in points} == {"phase-space"}
    assert all(error < 3e-4 for p in points for error in p["error"].values())


def test_only_the_summary_is_printed_once_written(fpk, tmp_path):
    line = ["regime", "fig3a", "--vary", "contact.clearance=0.5:2:2"]
    status, out, err = fpk(*line)
    assert (status, err) == (0, "") and "energy averaging" in out
    assert "2 points (0 from disk)" in out
    status, out, err = fpk(*line, "--out", tmp_path)
    assert (status, err) == (0, "") and "|" not in out and out.startswith("p(q2), 2 points")
    for ending in ("md", "nc", "svg", "csv"):
        path = tmp_path / f"regime.{ending}"
        assert path.stat().st_size > 100 and f"wrote {path}" in out
    page = (tmp_path / "regime.html").read_text(encoding="utf-8")
    # The policy of the page allows its one style by its hash, and no style of an element.
    assert "style-src 'sha256-" in page and ' style="' not in page and page.count("<style") == 1


def test_a_scene_without_contact_has_no_map(refusal, written, linear_text):
    assert "[[contact]]" in refusal("regime", written(linear_text), *GRID)
