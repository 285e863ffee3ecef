"""The disk cache of compiled functions: damage costs a compilation, and Ctrl-C is obeyed."""

import os
import pickle
import threading
from hashlib import sha256

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


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Function that compiles x -> factor x; every call is like that of another process."""
    (tmp_path / "scaled.py").write_text(SOURCE)
    monkeypatch.setattr("numba.core.config.CACHE_DIR", "")
    namespace = {"__name__": "scaled", "__file__": str(tmp_path / "scaled.py")}
    exec(compile(SOURCE, str(tmp_path / "scaled.py"), "exec"), namespace)
    alive = []

    def made(factor):
        # numba finds the constants of what it loads among functions that exist.
        alive.append(namespace["made"](factor))
        return alive[-1]

    return made


def flipped(content):
    return content[:-9] + bytes([content[-9] ^ 0x10]) + content[-8:]


DAMAGES = {
    "empty": lambda content: b"",
    "cut": lambda content: content[:-1],
    "longer": lambda content: content + b"x",
    "flipped": flipped,
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("ending", ["nbi", "nbc"])
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


def test_an_index_that_names_a_missing_class_is_not_used(made, tmp_path):
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


def test_who_waits_for_a_compilation_can_be_interrupted():
    """Ctrl-C on the main thread and on all that wait; nested calls and errors pass through."""
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
