"""A file is under its name whole, or what was there before is: full disks, kills, permissions."""

import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import pytest

from cases.compare.routes import method_for
from cases.compare.stationary import run_scene
from cases.scene.errors import BadInput
from cases.scene.scene import load_scene
from cases.show.digest import digest_of
from cases.show.fields import write_csv, write_netcdf
from cases.show.files import LOCK, make_folder, output_folder, write_by, write_text
from cases.show.pictures.svg import svg_text
from cases.show.report import write_report
from cases.show.vtk import write_pvd, write_vtu
from cases.study.regime_map import build_map

resource = pytest.importorskip("resource", reason="limits of a process are Unix's")


@contextmanager
def disk_of(size):
    """No file of this process grows beyond ``size`` bytes: like a full disk, errno aside."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture(scope="module")
def outcome():
    scene = load_scene("fig6a")
    few = {"observables": scene.observables[:1], "curves": scene.curves[:1], "expect": None}
    scene = replace(scene, **few)
    return run_scene(scene, [method_for("nonintegrable", "closed-form")])


@pytest.fixture(scope="module")
def regime_map():
    return build_map(load_scene("fig3a"), ["contact.clearance=0.5,1"])


def _svg(folder, outcome):
    from matplotlib.figure import Figure  # noqa: PLC0415

    write_text(folder / "a.svg", svg_text(Figure(), salt="a"))


WRITERS = {
    "report": lambda folder, outcome: write_report(outcome, digest_of(outcome), folder),
    ".svg": _svg,
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
    for size in (sizes[0] // 2, sizes[-1] - 1):
        with disk_of(size), pytest.raises(BadInput, match="cannot be written") as refusal:
            write()
        assert "\n" not in str(refusal.value) and "make room" in str(refusal.value)
        after = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
        assert after.keys() == before.keys()
        for name, content in after.items():  # netCDF and the report hold the time; same length
            assert content == before[name] or len(content) == len(before[name]) <= size


def test_a_failing_write_keeps_what_was_there(tmp_path):
    path = tmp_path / "report.html"
    write_text(path, "before")

    def half(temporary):
        temporary.write_text("hal")
        raise OSError(28, "No space left on device")

    with pytest.raises(BadInput, match="No space left"):
        write_by(path, half)
    assert path.read_text() == "before"
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


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


@pytest.mark.parametrize("before", ["before", None])
def test_a_killed_run_leaves_no_half_file_under_its_name(before, tmp_path):
    path = tmp_path / "result.nc"
    if before is not None:
        path.write_text(before)
    done = subprocess.run([sys.executable, "-c", KILLED, path], check=False)
    assert done.returncode == -signal.SIGKILL
    assert (path.read_text() if path.exists() else None) == before
    write_text(path, "after")
    assert path.read_text() == "after"


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file" / "below", tmp_path / "nul\0"):
        with pytest.raises(BadInput) as refusal:
            make_folder(path)
        assert "\n" not in str(refusal.value)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root writes anywhere")
def test_a_folder_without_permission_is_one_line(fpk, tmp_path):
    tmp_path.chmod(0o555)
    assert_cannot_be_written(fpk, tmp_path)


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="/proc takes no file, root's neither")
def test_a_folder_that_takes_no_file_is_one_line(fpk):
    assert_cannot_be_written(fpk, "/proc")


def assert_cannot_be_written(fpk, folder):
    for arguments in (
        ["run", "fig3a", "--out", folder],
        ["run", "fig3a", "--out", f"{folder}/new"],
        ["export", "fig3a", "--out", f"{folder}/a.csv"],
        ["regime", "fig3a", "--vary", "contact.clearance=0.5:2:2", "--out", folder],
    ):
        status, out, err = fpk(*arguments)
        assert (status, out) == (2, "")
        assert err.count("\n") == 1 and "cannot be written" in err and str(folder) in err


def test_a_folder_in_the_place_of_a_file_is_kept(tmp_path):
    (tmp_path / "a.csv" / "inner").mkdir(parents=True)
    with pytest.raises(BadInput, match="cannot be written"):
        write_text(tmp_path / "a.csv", "text")
    assert [p.name for p in tmp_path.rglob("*")] == ["a.csv", "inner"]


GRID = ("--vary", "contact.stiffness=1:2:2")
WRITING = [
    ("run", "fig3a"),
    ("sweep", "fig3a", *GRID, "--quantity", "rms(q2)"),
    ("regime", "fig3a", *GRID),
    ("converge", "fig3a"),
    ("cost", "fig3a"),
]


@pytest.mark.parametrize("command", WRITING, ids=lambda command: command[0])
def test_a_folder_is_written_by_one_command_at_a_time(command, fpk, tmp_path, monkeypatch):
    """The second one is refused before any work, and leaves what is there."""

    def worked(*_, **__):
        raise AssertionError("worked")

    monkeypatch.setattr("cases.compare.stationary.run_scene", worked)
    monkeypatch.setattr("cases.study.sweep.sweep.sweep_point", worked)
    with output_folder(tmp_path):
        status, out, err = fpk(*command, "--out", tmp_path)
    assert (status, out) == (2, "") and err.count("\n") == 1
    assert "another process is using this folder; wait until it has ended" in err
    assert [path.name for path in tmp_path.iterdir()] == [LOCK]


def test_two_runs_at_once_leave_the_report_of_one(tmp_path):
    """Both in processes of their own: one is done, the other is refused."""
    call = ("run", "fig3a", "--method", "exact", "--of", "q2", "--out", str(tmp_path))
    command = [sys.executable, "-c", "from cases.command.cli import main; main()", *call]
    both = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    ends = [(process.communicate()[1], process.returncode) for process in both]
    assert sorted(status for _, status in ends) in ([0, 2], [0, 0])  # 0, 0: one after the other
    assert all("using this folder" in err for err, status in ends if status == 2)
    assert (tmp_path / "report.html").is_file()


def test_what_a_killed_process_left_is_removed_by_the_next_command(fpk, tmp_path):
    for name in (".fpk-ab12_x9z", ".fpk-notes"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "report.html").write_text("half")
    call = ("run", "fig3a", "--method", "exact", "--of", "q2", "--out", tmp_path)
    assert fpk(*call)[0] == 0
    assert [path.name for path in tmp_path.glob(".fpk-*")] == [".fpk-notes"]  # no name of ours
