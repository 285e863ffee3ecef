"""The map of regimes: its grid, which theory is nearer, and going on where it was stopped."""

import json

import numpy as np
import pytest
import xarray as xr

from cases.scene.errors import BadInput
from cases.scene.scene import load_scene
from cases.show.files import write_text
from cases.study.regime_map import build_map, winner_of
from cases.study.sweep.grid import parse_axes

GRID = ["--vary", "contact.stiffness=0.01:100:log2", "--vary", "contact.clearance=0.5:2:2"]
QUICK = ["--paths", 4096, "--time", 30, "--seed", 3]


def test_a_grid_reaches_both_ends_evenly_or_in_equal_ratios():
    system = load_scene("fig6a").system
    B, delta = parse_axes(["contact.stiffness=0.01:100:log5", "contact.clearance=0:2:5"], system)
    assert B.values.tolist() == [0.01, 0.1, 1.0, 10.0, 100.0] and B.logarithmic
    assert delta.values.tolist() == [0.0, 0.5, 1.0, 1.5, 2.0] and delta.symbol == "δ"


@pytest.mark.parametrize(
    ("texts", "word"),
    [
        (["contact.stiffness"], "low:high:count"),
        (["contact.stiffnes=1:2:3"], "contact[1..1].stiffness"),
        (["system.dampin=1:2:3"], "system.damping[1..2,1..2]"),
        (["contact.stiffness=1:2"], "low:high:count"),
        (["contact.stiffness=1:2:x"], "logCOUNT"),
        (["contact.stiffness=1:2:ln3"], "logCOUNT"),
        (["contact.stiffness=1:2:1"], "count of 1"),
        (["contact.stiffness=2:1:3"], "not below"),
        (["contact.stiffness=0:1:log3"], "low end > 0"),
        (["contact.stiffness=-1:1:3"], "> 0"),
        (["contact.stiffness=nan:1:3"], "finite"),
        (["contact.stiffness=1:1e999:3"], "finite"),
        (["contact.stiffness=1:2:99999"], "count of 99999"),
        (["contact.stiffness=1:2:3", "contact.stiffness=1:2:3"], "varied already"),
        (["contact.stiffness=1:2:100", "contact.clearance=1:2:100"], "at most"),
        (["contact.stiffness=1:2:3"] * 3, "3 times"),
    ],
)
def test_what_is_no_grid_is_refused_in_one_line(texts, word):
    with pytest.raises(BadInput, match=r"--vary") as refusal:
        parse_axes(texts, load_scene("fig6a").system)
    assert word in str(refusal.value) and "\n" not in str(refusal.value)


def test_the_nearer_theory_is_named_beyond_the_noise_only():
    assert winner_of({"a": (0.1, 0.01), "b": (0.2, 0.01)}) == "a"
    assert winner_of({"a": (0.2, 0.01), "b": (0.1, 0.01)}) == "b"
    assert winner_of({"a": (0.1, 0.01), "b": (0.115, 0.01)}) == "undecided"
    assert winner_of({"b": (0.1, 0.01)}) == "b" and winner_of({}) == "neither"


def stopped_after(count):
    written = []

    def write(path, text):
        if len(written) == count:
            raise KeyboardInterrupt
        written.append(path)
        write_text(path, text)

    return write


def test_a_map_is_written_and_goes_on_where_it_was(fpk, tmp_path, monkeypatch):
    status, out, err = fpk("regime", "fig6a", *GRID, *QUICK, "--out", tmp_path, "--json")
    first = json.loads(out)
    assert (status, err, first["reused"], len(first["points"])) == (0, "", 0, 4)
    winners = {tuple(p["values"]): p["winner"] for p in first["points"]}
    assert winners[0.01, 0.5] == winners[100.0, 2.0] == "integrable"
    assert winners[100.0, 0.5] == "nonintegrable"
    with xr.open_dataset(tmp_path / "regime.nc", engine="h5netcdf") as data:
        assert data["L1"].shape == (2, 2, 2) and np.all(data["L1"] > 0)
        best = data["L1"].sel(theory="nonintegrable").sel({"contact.stiffness": 100}).values
        assert best[0] < best[1]
    assert (tmp_path / "regime.csv").read_text().count("\n") == 5
    assert (tmp_path / "regime.svg").read_text().startswith("<?xml")
    # Stopped in the middle, at any moment after the second point.
    (tmp_path / "points.jsonl").unlink()
    with monkeypatch.context() as context:
        context.setattr("cases.study.sweep.points.write_text", stopped_after(2))
        assert fpk("regime", "fig6a", *GRID, *QUICK, "--out", tmp_path, "--json")[0] == 130
    again = json.loads(fpk("regime", "fig6a", *GRID, *QUICK, "--out", tmp_path, "--json")[1])
    assert again["reused"] == 2
    for a, b in zip(first["points"], again["points"], strict=True):
        assert {**a, "seconds": 0} == {**b, "seconds": 0}


def test_points_of_another_run_are_refused_and_kept(fpk, tmp_path):
    path = tmp_path / "points.jsonl"
    line = ["--vary", "contact.clearance=0.5:2:2", *QUICK, "--out", tmp_path]
    assert fpk("regime", "fig3a", *line)[0] == 0
    before = path.read_text()
    for arguments in (["fig4a", *line], ["fig3a", *line, "--seed", 4]):
        status, out, err = fpk("regime", *arguments)
        assert (status, out) == (2, "") and err.count("\n") == 1 and "another run" in err
    path.write_text("something else\n")
    assert fpk("regime", "fig3a", *line)[0] == 2
    assert path.read_text() == "something else\n" and '"exact"' in before


def test_where_there_is_an_exact_answer_no_simulation_is_needed(monkeypatch):
    scene = load_scene("fig3a")
    found = build_map(scene, ["contact.clearance=0.5:2:3"])
    assert {p.reference for p in found.points} == {"exact"} and not found.problems
    assert all(p.L1["nonintegrable"] < 1e-10 for p in found.points)


def test_the_equation_of_the_full_system_judges_where_it_is_asked_to(fpk, tmp_path):
    grid = ["--vary", "contact.stiffness=0.1:0.2:2", "--reference", "phase-space", *QUICK]
    status, out, err = fpk("regime", "fig6a", *grid, "--out", tmp_path, "--json")
    found = json.loads(out)
    assert (status, err) == (0, "")
    assert {p["reference"] for p in found["points"]} == {"phase-space"}
    assert all(error < 3e-4 for p in found["points"] for error in p["error"].values())
    # Points of another reference are not mixed with these.
    status, _, err = fpk("regime", "fig6a", *grid[:2], *QUICK, "--out", tmp_path)
    assert status == 2 and "another run" in err


def test_a_map_is_printed_and_once_written_its_summary_only(fpk, tmp_path):
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


def test_a_scene_without_contact_has_no_map(fpk, tmp_path, scene_text):
    path = tmp_path / "free.toml"
    before, _, after = scene_text.partition("[[contact]]")
    path.write_text(before + "[observe]" + after.partition("[observe]")[2])
    status, out, err = fpk("regime", path, *GRID)
    assert (status, out) == (2, "") and "[[contact]]" in err
