"""Points of a map on disk: a cut line is dropped with a note, damage and other maps are refused."""

import json
import os
from dataclasses import replace

import pytest

from cases.scene.errors import BadInput
from cases.studies.regime_map.points import NAME, MapPoint, PointStore

IDENTITY = {
    "scene": "a\u2028b\u0085c\n", "observable": "q2", "keys": ["contact.stiffness"], "paths": 4096,
    "time": None, "relaxations": 38.0, "seed": 1, "version": "1",
}  # fmt: skip
"""Characters at which a scene's line does not end, though ``splitlines`` thinks so."""

POINTS = [
    MapPoint((x, 0.5), {"integrable": 0.1 / x}, {"integrable": 1e-3}, "exact", x, "integrable",
             ("é: a problem",) if x > 1 else (), 0.25)
    for x in (0.1, 1.0, 3.0)
]  # fmt: skip


@pytest.fixture
def written(tmp_path):
    store = PointStore(tmp_path, IDENTITY)
    for point in POINTS:
        store.add(point)
    return tmp_path / NAME


def reopened(path):
    return PointStore(path.parent, IDENTITY)


def test_what_was_written_is_read_to_the_last_digit(written):
    before = written.read_bytes()
    store = reopened(written)
    assert list(store.points.values()) == POINTS and store.note is None
    assert written.read_bytes() == before


def test_a_run_killed_after_any_byte_keeps_every_whole_line(written):
    """Appending is one write; a kill leaves any prefix of it, never less than the first line."""
    whole = written.read_bytes()
    head = whole.index(b"\n") + 1
    ends = {i + 1 for i in range(head, len(whole)) if whole[i : i + 1] == b"\n"}
    beside = {end + step for end in ends for step in (-1, 0, 1) if end + step <= len(whole)}
    for size in sorted({*range(head, len(whole) + 1, 11), *beside}):
        content = whole[:size]
        written.write_bytes(content)
        store = reopened(written)
        kept = content.count(b"\n") - 1
        assert list(store.points.values()) == POINTS[:kept]
        if content.endswith(b"\n"):
            assert store.note is None
        else:
            assert "cut off" in store.note and f"{kept} points" in store.note
        for point in POINTS[kept:]:
            store.add(point)
        assert written.read_bytes() == whole
    written.write_bytes(b"")
    assert not reopened(written).points


def test_a_byte_that_changed_is_never_read_as_a_number(written):
    whole = written.read_bytes()
    refused = 0
    for place in range(0, len(whole), 3):
        damaged = whole[:place] + bytes([whole[place] ^ 0x01]) + whole[place + 1 :]
        written.write_bytes(damaged)
        try:
            store = reopened(written)
        except BadInput as refusal:
            refused += 1
            assert "\n" not in str(refusal) and str(written) in str(refusal)
            assert written.read_bytes() == damaged
        else:  # the last line's end: as after a kill; or what a JSON reader need not tell apart
            assert all(point in POINTS for point in store.points.values())
    assert refused > 0.95 * len(whole) / 3


def test_lines_of_another_map_or_removed_or_doubled(written):
    head, *lines = written.read_text(encoding="utf-8").split("\n")[:-1]
    for key in IDENTITY:
        with pytest.raises(BadInput, match="another map"):
            PointStore(written.parent, {**IDENTITY, key: "x"})

    def read(*kept):
        text = "".join(f"{line}\n" for line in kept)
        written.write_text(text, encoding="utf-8")
        return reopened(written)

    assert len(read(head, lines[0], lines[2]).points) == 2
    assert len(read(head, lines[0], lines[0], lines[1]).points) == 2  # two runs at once
    foreign = json.dumps({**json.loads(lines[1]), "winner": "nonintegrable"})
    for kept in ([head, foreign], [head, lines[0], "", lines[1]], [head, head], [head, "[]", "{}"]):
        with pytest.raises(BadInput, match=r"line \d .* damaged; remove that line"):
            read(*kept)
    for kept in ([lines[0]], ["null", head], ["[" * 100_000], [""]):
        with pytest.raises(BadInput, match="another map"):
            read(*kept)


def test_the_same_point_with_other_numbers_is_refused(written):
    reopened(written).add(replace(POINTS[0], seconds=9.0))
    assert len(reopened(written).points) == 3
    reopened(written).add(replace(POINTS[0], L1={"integrable": 0.5}))
    with pytest.raises(BadInput, match=r"line 6 has other numbers"):
        reopened(written)


ODD = {
    "folder": (os.mkdir, "folder"),
    "pipe": (os.mkfifo, "regular file"),
    "endless": (lambda path: os.symlink("/dev/zero", path), "regular file"),
    "loop": (lambda path: os.symlink(NAME, path), "symbolic links"),
    "large": (lambda path: (path.touch(), os.truncate(path, 1 << 32)), "bytes"),
    "bytes": (lambda path: path.write_bytes(b"\xff\n"), "UTF-8"),
}


@pytest.mark.parametrize("kind", ODD)
def test_what_is_no_such_file_is_refused_without_reading_on(kind, tmp_path):
    make, words = ODD[kind]
    make(tmp_path / NAME)
    with pytest.raises(BadInput, match=words) as refusal:
        PointStore(tmp_path, IDENTITY)
    assert "\n" not in str(refusal.value) and str(tmp_path) in str(refusal.value)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_disk_that_fills_up_is_one_line(written):
    store = reopened(written)
    kept = written.rename(written.with_suffix(".kept"))
    written.symlink_to("/dev/full")
    with pytest.raises(BadInput, match="No space left on device; make room"):
        store.add(replace(POINTS[0], values=(9.0, 9.0)))
    kept.replace(written)
    assert list(reopened(written).points.values()) == POINTS
