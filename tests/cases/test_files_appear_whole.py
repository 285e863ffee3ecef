"""A file is under its name whole, or what was there before is."""

import pytest

from cases.errors import BadInput
from cases.files import make_folder, write_by, write_text


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


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file" / "below", tmp_path / "nul\0"):
        with pytest.raises(BadInput) as refusal:
            make_folder(path)
        assert "\n" not in str(refusal.value)
