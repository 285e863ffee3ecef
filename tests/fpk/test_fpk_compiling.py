"""Damaged files of the disk cache: compiled again, with a warning that names the file."""

import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest

SOURCE = '''
"""A module whose folder is the test's own, and so is its cache."""
from fpk.compiling import cached_njit

def made(factor):
    @cached_njit()
    def scaled(x):
        return factor * x
    return scaled
'''

ROOT = Path(__file__).parents[2]


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Function that compiles x -> factor x; every call is like that of another process."""
    (tmp_path / "scaled.py").write_text(SOURCE)
    monkeypatch.setattr("numba.core.config.CACHE_DIR", "")
    namespace = {"__name__": "scaled", "__file__": str(tmp_path / "scaled.py")}
    exec(compile(SOURCE, str(tmp_path / "scaled.py"), "exec"), namespace)
    held = []

    def made(factor):
        # numba finds the constants of what it loads among functions that exist, or imports their
        # module, which here has no name that can be imported.
        held.append(namespace["made"](factor))
        return held[-1]

    return made


DAMAGES = {
    "empty": lambda content: b"",
    "cut": lambda content: content[:-1],
    "half": lambda content: content[: len(content) // 2],
    "short": lambda content: content[:5],
    "longer": lambda content: content + b"x",
    **{
        f"flipped at {share}": lambda content, share=share: flipped(content, share)
        for share in (0.0, 0.01, 0.3, 0.7, 0.999)
    },
}


def flipped(content, share):
    damaged = bytearray(content)
    damaged[int(share * len(content))] ^= 0x10
    return bytes(damaged)


@pytest.mark.parametrize(("ending", "damage"), [*product(("nbi", "nbc"), DAMAGES)])
def test_a_damaged_file_is_compiled_again_with_a_warning(ending, damage, made, tmp_path):
    assert made(2.0)(3.0) == 6.0
    again = made(2.0)
    assert again(3.0) == 6.0 and sum(again.stats.cache_hits.values()) == 1
    (path,) = tmp_path.rglob(f"*.{ending}")
    path.write_bytes(DAMAGES[damage](path.read_bytes()))
    with pytest.warns(UserWarning, match="is damaged") as warned:
        again = made(2.0)
        assert again(3.0) == 6.0 and not again.stats.cache_hits
    assert len(warned) == 1 and str(path) in str(warned[0].message)
    last = made(2.0)  # the cache is whole again
    assert last(3.0) == 6.0 and sum(last.stats.cache_hits.values()) == 1


def test_data_of_another_function_under_the_same_name_are_not_used(made, tmp_path):
    """As two processes leave them that both gave the first free number to theirs."""
    made(2.0)(3.0)
    made(5.0)(3.0)
    first, second = sorted(tmp_path.rglob("*.nbc"))
    first.write_bytes(second.read_bytes())
    again = made(2.0)
    assert again(3.0) == 6.0 and not again.stats.cache_hits
    assert made(5.0)(3.0) == 15.0


def test_a_full_disk_costs_the_cache_only(made, monkeypatch):
    def full(source, destination):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.warns(UserWarning, match="No space left"):
        assert made(2.0)(3.0) == 6.0


def test_control_c_that_llvm_dropped_is_raised_again(made, monkeypatch):
    """As numba leaves a function whose object code never reached it."""

    def lost(self):
        raise RuntimeError(f"no compiled object yet for {self}")

    monkeypatch.setattr("numba.core.codegen.CPUCodeLibrary._get_compiled_object", lost)
    with pytest.raises(KeyboardInterrupt):
        made(2.0)(3.0)


@pytest.mark.slow
def test_the_command_line_answers_with_damaged_caches(tmp_path):
    """The answer is the same, and each damaged file is a line of warning."""
    command = ["density", "vanderpol", "--method", "nonintegrable", "--solver", "fem",
               "--of", "q1", "--at", "0,0.5"]  # fmt: skip

    def answer():
        done = subprocess.run(
            [sys.executable, "-c", "from cases.commands.cli import main; main()", *command],
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout, done.stderr

    out, err = answer()
    assert "warning" not in err
    damaged = sorted(tmp_path.rglob("*.nb[ic]"))
    assert len(damaged) >= 4
    for k, path in enumerate(damaged):
        path.write_bytes(path.read_bytes()[: -k % 3 * 100])
    again, err = answer()
    lines = [line for line in err.splitlines() if "is damaged" in line]
    assert again == out and lines and all(line.startswith("fpk: warning: ") for line in lines)
    assert answer() == (out, "")
