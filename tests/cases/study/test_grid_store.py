"""Points of a grid on disk: whole at every point, damage is refused; folders of other runs."""

import json
import os
from dataclasses import replace

import pytest

from cases.scene.errors import BadInput
from cases.show.claim import claim_folder
from cases.study.sweep.points import POINTS_FILE, PointStore, SweepPoint, Value

POINTS = [
    SweepPoint(
        (x, 0.5),
        (Value("rms(q2)", "exact", 0.1 / x, 1e-3, failures=("é: a failure",) if x > 1 else ()),),
        0.25,
    )
    for x in (0.1, 1.0, 3.0)
]


@pytest.fixture
def written(tmp_path):
    store = PointStore(tmp_path, IDENTITY)
    for point in POINTS:
        store.add(point)
    return tmp_path / POINTS_FILE


def reopened(path):
    return PointStore(path.parent, IDENTITY)


def test_what_was_written_is_read_to_the_last_digit(written):
    before = written.read_bytes()
    store = reopened(written)
    assert list(store.points.values()) == POINTS
    assert written.read_bytes() == before


def test_a_point_that_cannot_be_written_leaves_all_points_before(written, monkeypatch):
    before = written.read_bytes()
    store = reopened(written)

    def killed(source, destination):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as context:  # the last step of writing: what was there is replaced
        context.setattr("os.replace", killed)
        with pytest.raises(BadInput, match=r"No space left on device; .* make room"):
            store.add(replace(POINTS[0], values=(9.0, 9.0)))
    assert written.read_bytes() == before and os.listdir(written.parent) == [POINTS_FILE]
    again = reopened(written)
    again.add(replace(POINTS[0], values=(9.0, 9.0)))
    assert len(reopened(written).points) == 4


def test_a_byte_that_changed_or_is_missing_is_never_read_as_a_number(written):
    whole = written.read_bytes()
    last = whole.rindex(b"\n", 0, -1)
    for place in range(1, len(whole) - 1, 3):
        changed = bytes([whole[place] ^ 0x01])
        damaged = whole[:place] + changed + whole[place + 1 :]
        written.write_bytes(damaged)
        if place >= last:  # it may have been torn, and with its beginning the line before
            with pytest.warns(UserWarning, match="is torn and left out"):
                points = list(reopened(written).points.values())
            assert points == POINTS[: -1 if place > last else -2]
            continue
        with pytest.raises(BadInput) as refusal:
            reopened(written)
        assert "\n" not in str(refusal.value) and str(written) in str(refusal.value)
        assert written.read_bytes() == damaged


def test_a_torn_last_line_is_left_out_and_said(written):
    """As a power cut may leave the file, or a disk that is full: all points before it are there."""
    whole = written.read_bytes()
    ends = [k + 1 for k, byte in enumerate(whole) if byte == 10]
    for place in range(len(whole)):
        written.write_bytes(whole[:place])
        points = POINTS[: max(sum(end <= place + 1 for end in ends) - 1, 0)]
        if place in (0, *ends, *(end - 1 for end in ends)):  # but for its end, a line may be whole
            assert list(reopened(written).points.values()) == points
            continue
        with pytest.warns(UserWarning, match=r"points\.jsonl: its last line is torn and left out"):
            store = reopened(written)
        assert list(store.points.values()) == points
    store.add(POINTS[2])
    assert list(reopened(written).points.values()) == POINTS and written.read_bytes() == whole


def test_lines_that_were_changed_or_removed_or_doubled_are_refused(written):
    head, *lines = written.read_text(encoding="utf-8").split("\n")[:-1]
    foreign = json.dumps({**json.loads(lines[1]), "seconds": 0.5})
    for kept in (
        [head, *lines[1:]],
        [head, lines[0], *lines],
        [head, lines[0], foreign, lines[2]],
        [*lines],
        ["null", head],
        ["[" * 100_000],
        ["", ""],
    ):
        written.write_text("".join(f"{line}\n" for line in kept), encoding="utf-8")
        with pytest.raises(BadInput, match=r"is damaged or another run.s; .* remove the file"):
            reopened(written)


IDENTITY = {
    "scene": "a\u2028b\u0085c\n", "observable": "q2", "keys": ["contact.stiffness"], "paths": 4096,
    "time": None, "relaxations": 38.0, "seed": 1,
}  # fmt: skip
"""Characters at which a scene's line does not end, though ``splitlines`` thinks so."""


def test_a_folder_of_another_run_or_version_is_refused_and_stays(tmp_path, monkeypatch):
    for _ in range(2):
        with claim_folder(tmp_path, IDENTITY):
            pass
    before = (tmp_path / "run.json").read_bytes()
    for key in IDENTITY:
        with (
            pytest.raises(BadInput, match="another run"),
            claim_folder(tmp_path, {**IDENTITY, key: "x"}),
        ):
            pass
    monkeypatch.setattr("cases.show.claim.program_version", lambda: "another")
    with pytest.raises(BadInput, match="version"), claim_folder(tmp_path, IDENTITY):
        pass
    assert (tmp_path / "run.json").read_bytes() == before


ODD = {
    "folder": (os.mkdir, "folder"),
    "pipe": (os.mkfifo, "regular file"),
    "endless": (lambda path: os.symlink("/dev/zero", path), "regular file"),
    "loop": (lambda path: os.symlink(POINTS_FILE, path), "symbolic links"),
    "large": (lambda path: (path.touch(), os.truncate(path, 1 << 32)), "bytes"),
    "bytes": (lambda path: path.write_bytes(b"\xff\n"), "UTF-8"),
}


@pytest.mark.parametrize("kind", ODD)
def test_what_is_no_such_file_is_refused_without_reading_on(kind, tmp_path):
    make, words = ODD[kind]
    make(tmp_path / POINTS_FILE)
    with pytest.raises(BadInput, match=words) as refusal:
        PointStore(tmp_path, IDENTITY)
    assert "\n" not in str(refusal.value) and str(tmp_path) in str(refusal.value)


def test_points_of_another_map_are_refused_where_nothing_else_names_theirs(written):
    before = written.read_bytes()
    with pytest.raises(BadInput, match="another run's"):
        PointStore(written.parent, {**IDENTITY, "scene": "another"})
    assert written.read_bytes() == before


def test_a_sweep_goes_on_from_a_torn_file(fpk, tmp_path):
    call = ("sweep", "fig3a", "--vary", "contact.stiffness=1,2", "--quantity", "rms(q2)",
            "--method", "nonintegrable/closed-form", "--json", "--out", tmp_path)  # fmt: skip
    first = json.loads(fpk(*call)[1])
    stored = tmp_path / POINTS_FILE
    stored.write_bytes(stored.read_bytes()[:-40])
    with pytest.warns(UserWarning, match="its last line is torn and left out"):
        status, out, _ = fpk(*call)
    again = json.loads(out)
    assert status == 0 and (first["reused"], again["reused"]) == (0, 1)
    values = [[a["value"] for p in record["points"] for a in p["answers"]]
              for record in (first, again)]  # fmt: skip
    assert values[0] == values[1]
