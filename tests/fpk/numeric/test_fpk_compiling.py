"""Damaged files of the disk cache: compiled again, with a warning that names the file."""

import os
import pickle
import signal
import subprocess
import sys
import threading
from hashlib import sha256
from itertools import product
from pathlib import Path

import numba
import pytest

from fpk.numeric.compiling import COMPILER, abandon, abandoned, interruptible_compile

SOURCE = '''
"""A module whose folder is the test's own, and so is its cache."""
from fpk.numeric.compiling import cached_njit

def made(factor):
    @cached_njit()
    def scaled(x):
        return factor * x
    return scaled
'''

ROOT = Path(__file__).parents[3]


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


def test_an_index_with_types_of_another_version_is_of_no_use(made, tmp_path):
    """It names a class of a module that is no longer there."""
    made(2.0)(3.0)
    (path,) = tmp_path.rglob("*.nbi")
    content = pickle.dumps(numba.__version__) + b"cno_such_module\nDiffusion\n."
    path.write_bytes(content + sha256(content).digest())
    again = made(2.0)
    assert again(3.0) == 6.0 and not again.stats.cache_hits


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


def test_who_waits_for_a_function_that_is_compiled_can_be_interrupted():
    """Ctrl-C on the main thread, and all that wait on others; what is compiled on the way, none."""
    begun, may_end = threading.Event(), threading.Event()

    def endless(signature):
        begun.set()
        may_end.wait()
        return signature

    compiled = interruptible_compile(endless)

    def other():
        with pytest.raises(KeyboardInterrupt):
            compiled("another thread's")
        ended.append(True)

    ended, thread = [], threading.Thread(target=other)
    thread.start()
    begun.wait()
    begun.clear()
    pressed = threading.Thread(target=lambda: (begun.wait(), abandon()))
    pressed.start()
    with pytest.raises(KeyboardInterrupt):
        compiled("this thread's")
    thread.join()
    pressed.join()
    assert ended and abandoned
    with pytest.raises(KeyboardInterrupt):  # numba compiles one function at a time
        compiled("a later one's")
    may_end.set()
    for own in threading.enumerate():
        if own.name == COMPILER:
            own.join()
    assert not abandoned and compiled(3) == 3

    def failing(signature):
        raise ValueError(signature)

    nested = interruptible_compile(lambda signature: (compiled(signature), threading.get_ident()))
    assert nested(5)[0] == 5 and nested(5)[1] != threading.get_ident() and not abandoned
    with pytest.raises(ValueError, match="reason"):
        interruptible_compile(failing)("reason")


INTERRUPTED = """
import signal, sys
from numba.core import event

class Begun(event.Listener):
    def on_start(self, found):
        if found.data["dispatcher"].py_func.__name__ == "advance":
            print("begun", flush=True)

    def on_end(self, found):
        if found.data["dispatcher"].py_func.__name__ == "advance":
            print("done", flush=True)

event.register("numba:compile", Begun())
signal.signal(signal.SIGINT, signal.default_int_handler)
from cases.command.cli import main
main()
"""


@pytest.mark.slow  # the kernel is compiled for many seconds where Ctrl-C does not end that
@pytest.mark.parametrize("command", [
    ["density", "fig6a", "--method", "montecarlo", "--of", "q2", "--at", "0"],
    ["run", "fig6a", "--method", "montecarlo", "--out", "out"],
])  # fmt: skip
def test_control_c_does_not_wait_for_what_is_compiled(command, tmp_path):
    """With an empty cache: one line, status 130, before the kernel is compiled; nothing is left."""
    cache, folder = tmp_path / "cache", tmp_path / "folder"
    cache.mkdir()
    folder.mkdir()
    process = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED, *command], cwd=folder, text=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout.readline() == "begun\n"
    process.send_signal(signal.SIGINT)
    out, err = process.communicate()
    assert (process.returncode, out) == (130, "")
    assert err.strip() == "fpk: stopped; nothing half-written was left"
    assert not list(cache.rglob("*advance*.nbc"))
    assert [path.name for path in folder.rglob("*")] in ([], ["out", ".fpk.lock"])


@pytest.mark.slow
def test_the_command_line_answers_with_damaged_caches(tmp_path):
    """The answer is the same, and each damaged file is a line of warning."""
    command = ["density", "fig6a", "--method", "nonintegrable", "--solver", "fem",
               "--of", "q1", "--at", "0,0.5"]  # fmt: skip

    def answer():
        done = subprocess.run(
            [sys.executable, "-c", "from cases.command.cli import main; main()", *command],
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
