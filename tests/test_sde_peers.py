"""The benchmark of packages for SDEs: who is missing is named, the page is that of the scripts.

None of the packages is needed here: scripts import them late.
"""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "benchmarks" / "sde_peers"
PAGE = ROOT / "docs" / "benchmarks" / "sde-peers.md"
PATHS = [str(FOLDER), str(FOLDER.parent), str(FOLDER.parent / "peers")]


def run(*arguments):
    command = [sys.executable, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def assert_code_runs(code):
    done = run("-c", f"import sys; sys.path[:0] = {PATHS!r}\n{code}")
    assert done.returncode == 0, done.stderr


def test_a_missing_package_is_named(tmp_path):
    if find_spec("torchsde"):
        pytest.skip("torchsde is installed")
    page = tmp_path / "page.md"
    done = run(str(FOLDER / "compare.py"), "--only", "torchsde", "--smallest", "--out", str(page))
    assert done.returncode == 0, done.stderr
    assert "torchsde: 0 lines, not installed" in done.stdout
    text = page.read_text()
    assert "torchsde: not installed." in text


def test_the_page_in_the_repository_has_the_structure_that_the_scripts_write():
    """Headings, headers and texts are the same, and every package's rows are its settings."""
    assert_code_runs(
        "from importlib import import_module\n"
        "from pathlib import Path\n"
        "import sde_page\n"
        f"text = Path({str(PAGE)!r}).read_text()\n"
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


@pytest.mark.slow
def test_numpy_by_hand_prints_lines_and_its_schemes_agree_with_ours(tmp_path):
    page, kept = tmp_path / "page.md", tmp_path / "lines.json"
    done = run(
        str(FOLDER / "compare.py"), "--only", "vibro-fpk", "--only", "NumPy", "--smallest",
        "--out", str(page), "--json", str(kept),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert '"kind": "sampling"' in kept.read_text() and "| NumPy | BAOAB |" in page.read_text()
