"""The benchmark of other programs: what needs only SciPy and scikit-fem runs, the rest is named."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PEERS = ROOT / "benchmarks" / "peers"
KEYS = {"peer", "version", "problem", "setting", "unknowns", "L1", "seconds", "minimum", "mass"}
ALWAYS = ("ours.py", "peer_chebyshev.py", "peer_chang_cooper.py", "peer_scikit_fem.py")
OTHERS = {"ngsolve": "peer_ngsolve.py", "fipy": "peer_fipy.py", "fplanck": "peer_fplanck.py"}
OTHERS |= {"pde": "peer_pypde.py"}


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


@pytest.mark.parametrize(
    "script",
    [s if "chebyshev" in s else pytest.param(s, marks=pytest.mark.slow) for s in ALWAYS],
)
def test_smallest_settings_print_measurements(script: str) -> None:
    done = run(str(PEERS / script), "--smallest")
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert {"W1", "W2"} <= {line["problem"] for line in lines}
    for line in lines:
        assert set(line) == KEYS | {"note"}
        # With mass one on both sides ∫|p_h − p| <= 2 unless p_h is negative; all are far below.
        assert 0.0 < line["L1"] < 0.1
        assert abs(line["mass"] - 1.0) < 1e-6
        assert line["seconds"] > 0.0 and line["unknowns"] > 0


@pytest.mark.parametrize("module", OTHERS)
def test_a_missing_peer_is_named(module: str) -> None:
    if find_spec(module):
        pytest.skip(f"{module} is installed")
    done = run(str(PEERS / OTHERS[module]), "--smallest")
    assert done.returncode == 3
    assert f"missing: {module}" in done.stderr


def test_the_page_names_who_is_missing_and_misses_no_figure(tmp_path: Path) -> None:
    page = tmp_path / "peers.md"
    done = run(
        str(PEERS / "run.py"), "--smallest", "--only", "Chang-Cooper", "--out", str(page)
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    text = page.read_text()
    for section in ("Figures to reach", "Failures", "Omissions", "All measurements"):
        assert f"## {section}" in text
    code = (
        f"import sys; sys.path[:0] = [{str(PEERS)!r}, {str(PEERS.parent)!r}]\n"
        "from page import written\n"
        "print(written([], {'FiPy': 'not installed'}))"
    )
    empty = run("-c", code)
    assert empty.returncode == 0, empty.stderr
    assert "FiPy: not installed." in empty.stdout
    assert "not reached, or not measured" in empty.stdout


def test_the_tables_of_the_readme_have_the_structure_of_the_pages(tmp_path: Path) -> None:
    script = str(ROOT / "benchmarks" / "readme_table.py")
    assert run(script, "--check").returncode == 0
    readme = tmp_path / "README.md"
    readme.write_text("before\n<!-- table: cost -->\n| old |\n| --- |\n<!-- end -->\nafter\n")
    stale = run(script, "--check", "--readme", str(readme))
    assert stale.returncode == 1 and "cost" in stale.stderr
    assert run(script, "--readme", str(readme)).returncode == 0
    text = readme.read_text()
    assert text.startswith("before\n<!-- table: cost -->\n| ms to") and text.endswith("after\n")
    assert run(script, "--check", "--readme", str(readme)).returncode == 0


def test_the_page_in_the_repository_has_the_rows_that_the_scripts_write() -> None:
    code = (
        f"import sys; sys.path[:0] = [{str(PEERS)!r}, {str(PEERS.parent)!r}]\n"
        "from page import KINDS, PROGRAMS\n"
        "from readme_table import page_blocks, structure\n"
        "programs = [PROGRAMS.get(k[0], k[0]) for k in KINDS]\n"
        "header, rows = structure(page_blocks()['cost'])\n"
        "assert len(header) == 7 and rows == list(dict.fromkeys(programs)), rows"
    )
    done = run("-c", code)
    assert done.returncode == 0, done.stderr
