"""A file is under its name whole, or what was there before is: full disks, kills, permissions."""

import os
import signal
import subprocess
import sys
from functools import partial

import pytest
from matplotlib.figure import Figure

from cases.scene.errors import BadInput
from cases.scene.scene import load_scene
from cases.show.digest import digest_of
from cases.show.fields import write_csv, write_netcdf
from cases.show.files import LOCK, make_folder, output_folder, write_text
from cases.show.pictures.svg import svg_text
from cases.show.report import write_report
from cases.show.vtk import write_pvd, write_vtu
from cases.study.regime_map import build_map

resource = pytest.importorskip("resource", reason="limits of a process are Unix's")


@pytest.fixture(scope="module")
def outcome(solved, scene_text):
    return solved(scene_text.replace(', "H"', ""), "nonintegrable/closed-form")


@pytest.fixture(scope="module")
def regime_map():
    return build_map(load_scene("fig3a"), ["contact.clearance=0.5,1"])


WRITERS = {
    "report": lambda folder, outcome: write_report(outcome, digest_of(outcome), folder),
    ".svg": lambda folder, _: write_text(folder / "a.svg", svg_text(Figure(), salt="a")),
    ".nc": lambda folder, outcome: write_netcdf(outcome, folder / "a.nc"),
    ".csv": lambda folder, outcome: write_csv(outcome, folder / "a.csv"),
    ".vtu": lambda folder, outcome: write_vtu(outcome, folder / "a.vtu"),
    ".pvd": lambda folder, outcome: write_pvd(outcome, folder / "a.pvd"),
    "map": lambda folder, result: result.page().write(folder),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_a_full_disk_is_one_line_and_keeps_what_was_there(kind, outcome, regime_map, tmp_path):
    write = partial(WRITERS[kind], tmp_path, regime_map if kind == "map" else outcome)
    write()
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert before and all(before.values())
    sizes = sorted(map(len, before.values()))
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    for size in (sizes[0] // 2, sizes[-1] - 1):
        # No file of this process grows beyond that: like a full disk, errno aside.
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, limit[1]))
        try:
            with pytest.raises(BadInput, match=r"cannot be written.*make room") as refusal:
                write()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        assert "\n" not in str(refusal.value)
        after = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
        assert after.keys() == before.keys()
        for name, content in after.items():  # netCDF and the report hold the time; same length
            assert content == before[name] or len(content) == len(before[name]) <= size


KILLED = """
import os, signal, sys
from pathlib import Path
from cases.show.files import write_by

def half(temporary):
    with temporary.open("w") as stream:
        stream.write("half")
        stream.flush()
        os.kill(os.getpid(), signal.SIGKILL)

write_by(Path(sys.argv[1]), half)
"""


def test_a_killed_run_leaves_no_half_file_under_its_name(tmp_path):
    path = tmp_path / "result.nc"
    write_text(path, "before")
    done = subprocess.run([sys.executable, "-c", KILLED, path], check=False)
    assert (done.returncode, path.read_text()) == (-signal.SIGKILL, "before")


def test_a_folder_that_cannot_be_made_or_is_in_the_place_of_a_file_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file" / "below", tmp_path / "nul\0"):
        with pytest.raises(BadInput) as refusal:
            make_folder(path)
        assert "\n" not in str(refusal.value)
    (tmp_path / "a.csv" / "inner").mkdir(parents=True)
    with pytest.raises(BadInput, match="cannot be written"):
        write_text(tmp_path / "a.csv", "text")
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["a.csv", "file", "inner"]


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="/proc takes no file, root's neither")
@pytest.mark.parametrize("line", ["run fig3a --out /proc/new", "export fig3a --out /proc/a.csv"])
def test_a_folder_that_takes_no_file_is_one_line(line, refusal):
    err = refusal(*line.split())
    assert "cannot be written" in err and "/proc" in err


GRID = ("--vary", "contact.stiffness=1:2:2")
WRITING = [
    ("run", "fig3a"),
    ("sweep", "fig3a", *GRID, "--quantity", "rms(q2)"),
    ("regime", "fig3a", *GRID),
    ("cost", "fig3a"),
]


@pytest.mark.parametrize("command", WRITING, ids=lambda command: command[0])
def test_a_folder_is_written_by_one_command_at_a_time(command, refusal, tmp_path, monkeypatch):
    """The second one is refused before any work, and leaves what is there."""
    for work in ("cases.compare.stationary.run_scene", "cases.study.sweep.sweep.sweep_point"):
        monkeypatch.setattr(work, None)
    with output_folder(tmp_path):
        err = refusal(*command, "--out", tmp_path)
    assert "another process is using this folder; wait until it has ended" in err
    assert [path.name for path in tmp_path.iterdir()] == [LOCK]


def test_what_a_killed_process_left_is_removed_by_the_next_command(fpk, tmp_path):
    for name in (".fpk-ab12_x9z", ".fpk-notes"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "report.html").write_text("half")
    call = ("run", "fig3a", "--method", "exact", "--of", "q2", "--out", tmp_path)
    assert fpk(*call)[0] == 0
    assert [path.name for path in tmp_path.glob(".fpk-*")] == [".fpk-notes"]  # no name of ours
