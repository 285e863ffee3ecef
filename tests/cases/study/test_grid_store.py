"""Points of a grid on disk: whole at every point, damage is refused; folders of other runs."""

import json
import os
from dataclasses import replace

import pytest

from cases.scene.errors import BadInput
from cases.study.sweep.points import POINTS_FILE, PointStore, SweepPoint, Value

POINTS = [
    SweepPoint(
        (x, 0.5),
        (Value("rms(q2)", "exact", 0.1 / x, 1e-3, failures=("é: a failure",) if x > 1 else ()),),
        0.25,
    )
    for x in (0.1, 1.0, 3.0)
]
IDENTITY = {
    "scene": "a\u2028b\u0085c\n", "observable": "q2", "keys": ["contact.stiffness"], "paths": 4096,
    "time": None, "relaxations": 38.0, "seed": 1,
}  # fmt: skip
"""Characters at which a scene's line does not end, though ``splitlines`` thinks so."""


@pytest.fixture
def written(tmp_path):
    store = PointStore(tmp_path, IDENTITY)
    for point in POINTS:
        store.add(point)
    return tmp_path / POINTS_FILE


def reopened(path):
    return list(PointStore(path.parent, IDENTITY).points.values())


def refused(path, match="is damaged or another run.s; .* remove the file", identity=IDENTITY):
    """Whether the file is refused in one line that names it, and stays as it is."""
    before = path.read_bytes() if path.is_file() else b""
    with pytest.raises(BadInput, match=match) as refusal:
        PointStore(path.parent, identity)
    assert "\n" not in str(refusal.value) and str(path) in str(refusal.value)
    return not before or path.read_bytes() == before


def test_what_was_written_is_read_to_the_last_digit_and_a_point_that_is_not_leaves_all_before(
    written, monkeypatch
):
    before = written.read_bytes()
    more = replace(POINTS[0], values=(9.0, 9.0))
    store = PointStore(written.parent, IDENTITY)
    assert list(store.points.values()) == POINTS and written.read_bytes() == before

    def full(source, destination):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as context:  # the last step of writing: what was there is replaced
        context.setattr("os.replace", full)
        with pytest.raises(BadInput, match=r"No space left on device; .* make room"):
            store.add(more)
    assert written.read_bytes() == before and os.listdir(written.parent) == [POINTS_FILE]
    PointStore(written.parent, IDENTITY).add(more)
    assert reopened(written) == [*POINTS, more]


def test_a_byte_that_changed_is_never_read_as_a_number(written):
    whole = written.read_bytes()
    ends = [k for k, byte in enumerate(whole) if byte == 10]
    for place in range(0, len(whole) - 1, 3):
        changed = bytes([whole[place] ^ 0x01])
        written.write_bytes(whole[:place] + changed + whole[place + 1 :])
        own = sum(end < place for end in ends)  # at its end a line is lost with the next
        lost = POINTS[own : own + 1 + (place in ends)]
        with pytest.warns(UserWarning, match="of its lines torn or changed, left out"):
            assert reopened(written) == [point for point in POINTS if point not in lost]


def test_a_torn_last_line_is_left_out_and_said(written):
    """As a power cut may leave the file, or a disk that is full: all points before it are there."""
    whole = written.read_bytes()
    ends = [k + 1 for k, byte in enumerate(whole) if byte == 10]
    for place in range(ends[0], len(whole)):
        written.write_bytes(whole[:place])
        points = POINTS[: sum(end <= place + 1 for end in ends)]
        if place in (*ends, *(end - 1 for end in ends)):  # but for its end, a line may be whole
            assert reopened(written) == points
            continue
        with pytest.warns(UserWarning, match=r"points\.jsonl: 1 of its lines torn or changed"):
            store = PointStore(written.parent, IDENTITY)
        assert list(store.points.values()) == points
    store.add(POINTS[2])
    assert reopened(written) == POINTS and written.read_bytes() == whole


def test_points_of_another_run_are_refused_and_what_is_no_point_is_left_out(written):
    assert refused(written, "another run's", {**IDENTITY, "scene": "another"})
    lines = written.read_text(encoding="utf-8").split("\n")[:-1]
    foreign = json.dumps({**json.loads(lines[1]), "seconds": 0.5})
    written.write_text("".join(f"{line}\n" for line in (lines[0], foreign, lines[2])))
    with pytest.warns(UserWarning, match="1 of its lines"):
        assert reopened(written) == [POINTS[0], POINTS[2]]
    for kept in ([foreign], ["null"], ["[" * 100_000], ["", ""]):
        written.write_text("".join(f"{line}\n" for line in kept), encoding="utf-8")
        assert refused(written)
    with written.open("wb") as file:
        file.truncate(1 << 32)
    with pytest.raises(BadInput, match="bytes"):
        PointStore(written.parent, IDENTITY)
    written.unlink()
    written.symlink_to("/dev/zero")
    with pytest.raises(BadInput, match="regular file"):
        PointStore(written.parent, IDENTITY)
