"""Benchmarks of other programs: this program's scripts run, who is missing is named.

Pages are those of the scripts. Packages for SDEs are imported late: none is needed here.
"""

import json
import runpy
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
PEERS = ROOT / "benchmarks" / "peers"
SDE_PEERS = ROOT / "benchmarks" / "sde_peers"
SDE_PAGE = ROOT / "docs" / "benchmarks" / "sde-peers.md"
PATHS = [str(SDE_PEERS), str(SDE_PEERS.parent), str(PEERS)]
KEYS = {"peer", "version", "problem", "setting", "unknowns", "L1", "seconds", "minimum", "mass"}


def run(*arguments):
    command = [sys.executable, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def test_smallest_settings_print_measurements():
    done = run(str(PEERS / "ours.py"), "--smallest")
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert {"W1", "W3", "W4"} <= {line["problem"] for line in lines}
    for line in lines:
        assert set(line) == KEYS | {"note"}
        # The tolerance is 1e-4: coefficients of another density are seen.
        assert 0.0 < line["L1"] < 1e-3
        assert abs(line["mass"] - 1.0) < 1e-6
        assert line["seconds"] > 0.0 and line["unknowns"] > 0


@pytest.mark.parametrize(
    ("file", "kind", "names"),
    [("coupled", "Mixture", ["W3"]), ("vanderpol", "Averaged", ["W4", "vanderpol"])],
)
def test_the_peers_get_the_coefficients_of_the_process(file, kind, names, monkeypatch):
    monkeypatch.syspath_prepend(PEERS)
    problem = runpy.run_path(str(PEERS / f"{file}.py"))[kind](*names)
    at = np.array([[0.0, 0.02, 0.3], [0.1, 0.4, 0.05]])
    drift, (b, d), divergence = problem.coefficients(at)
    c, of = problem.cross(at) if file == "coupled" else 0.0 * at[0], problem.process.at(at.T)
    np.testing.assert_allclose(drift, of.drift.T, rtol=1e-13, atol=1e-16)
    np.testing.assert_allclose(np.moveaxis(of.diffusion, 0, -1), [[b, c], [c, d]])
    np.testing.assert_allclose(divergence, of.divergence.T)


def test_a_missing_peer_is_named():
    if find_spec("fipy"):
        pytest.skip("fipy is installed")
    done = run(str(PEERS / "peer_fipy.py"), "--smallest")
    assert done.returncode == 3
    assert "missing: fipy" in done.stderr


def test_the_short_tables_have_the_structure_of_the_pages(tmp_path):
    script = str(ROOT / "benchmarks" / "measured_tables.py")
    assert run(script, "--check").returncode == 0
    page = tmp_path / "measured.md"
    page.write_text("before\n<!-- table: cost -->\n| old |\n| --- |\n<!-- end -->\nafter\n")
    stale = run(script, "--check", "--page", str(page))
    assert stale.returncode == 1 and "cost" in stale.stderr
    assert run(script, "--page", str(page)).returncode == 0
    text = page.read_text()
    assert text.startswith("before\n<!-- table: cost -->\n| ms to") and text.endswith("after\n")
    assert run(script, "--check", "--page", str(page)).returncode == 0


def assert_code_runs(code):
    done = run("-c", f"import sys; sys.path[:0] = {PATHS!r}\n{code}")
    assert done.returncode == 0, done.stderr


def test_the_page_in_the_repository_has_the_rows_that_the_scripts_write():
    assert_code_runs(
        "from page import PROGRAMS, written\n"
        "from measured_tables import page_blocks, structure\n"
        "header, rows = structure(page_blocks()['cost'])\n"
        "assert len(header) == 7 and rows == list(PROGRAMS.values()), rows\n"
        "assert 'FiPy: not installed.' in written([], {'FiPy': 'not installed'})\n"
    )


def test_a_missing_sde_package_is_named(tmp_path):
    if find_spec("diffrax"):
        pytest.skip("diffrax is installed")
    page = tmp_path / "page.md"
    done = run(str(SDE_PEERS / "compare.py"), "--only", "diffrax", "--smallest", "--out", str(page))
    assert done.returncode == 0, done.stderr
    assert "diffrax: 0 lines, not installed" in done.stdout
    assert "diffrax: not installed." in page.read_text()


def test_the_page_of_sde_packages_has_the_structure_that_the_scripts_write():
    """Headings, headers and texts are the same, and every package's rows are its settings."""
    assert_code_runs(
        "from importlib import import_module\n"
        "from pathlib import Path\n"
        "import sde_page\n"
        f"text = Path({str(SDE_PAGE)!r}).read_text()\n"
        "empty = sde_page.written([], {})\n"
        "def structure(page):\n"
        "    lines = page.splitlines()\n"
        "    marks = [k for k, line in enumerate(lines) if line.startswith('| ---')]\n"
        "    return [x for x in lines if x.startswith('#')], [lines[k - 1] for k in marks]\n"
        "assert structure(text) == structure(empty)\n"
        "for words in (sde_page.INTRODUCTION, sde_page.FOUND, sde_page.OMISSIONS):\n"
        "    assert words in text\n"
        "table = text.split('## All measurements')[1].split('\\n## ')[0]\n"
        "rows = [[c.strip() for c in x.strip('|').split('|')] for x in table.splitlines()\n"
        "        if x.startswith('| ')][2:]\n"
        "missing = text.split('## Missing')[1].split('\\n## ')[0]\n"
        "for peer, script in sde_page.SCRIPTS.items():\n"
        "    settings = import_module(script.removesuffix('.py')).SETTINGS\n"
        "    assert settings and all(s.step > 0 and s.order >= 1 for s in settings), script\n"
        "    wanted = [[s.scheme, f'{s.step:g}'] for s in settings]\n"
        "    found = [row[1:3] for row in rows if row[0] == peer]\n"
        "    assert found == wanted or f'{peer}: ' in missing, (peer, found, wanted)\n"
    )


def test_an_allowed_step_follows_the_order_and_is_not_made_up():
    assert_code_runs(
        "from math import isclose\n"
        "from trial import Setting, WANTED, allowed_step\n"
        "setting = Setting('some', 0.3, 2, 64)\n"
        "assert isclose(allowed_step(setting, -9.0 * WANTED, 0.1 * WANTED), 0.1)\n"
        "assert allowed_step(setting, 0.2 * WANTED, 0.1 * WANTED) == 0.3  # never longer\n"
        "assert allowed_step(setting, 2.0 * WANTED, WANTED) is None  # not told from none\n"
        "assert allowed_step(setting, None, None) is None\n"
        "import numpy as np\n"
        "from problem import probabilities\n"
        "from trial import density_bias\n"
        "p = probabilities()\n"
        "assert isclose(p.sum(), 1.0) and p.min() > 0\n"
        "q = p.copy(); q[20] += 0.01; q[32] -= 0.01\n"
        "rng = np.random.default_rng(5)\n"
        "n = 10**7\n"
        "right = density_bias(np.array([rng.multinomial(n, p) for _ in range(2)]))\n"
        "wrong = density_bias(np.array([rng.multinomial(n, q) for _ in range(2)]))\n"
        "# noise of 2e7 samples in 65 bins: Σ √(2 p/(π n)) <= √(2 65/(π n)) = 1.4e-3\n"
        "assert right['L1'] < 1.4e-3 and abs(wrong['L1'] - 0.02) < 1.4e-3\n"
        "from trial import best\n"
        "line = dict(kind='scheme', peer='a', scheme='b')\n"
        "coarse = line | dict(step=0.4, allowed=0.2, ns_time=1.0)\n"
        "fine = line | dict(step=0.3, allowed=0.1, ns_time=2.0)\n"
        "assert best([coarse, fine], ('a',)) is fine and best([coarse], ('c',)) is None\n"
    )
