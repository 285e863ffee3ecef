"""The benchmark of other programs: what needs only SciPy and scikit-fem runs, the rest is named."""

import json
import runpy
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from fpk.numeric.quadrature import panel_rule

ROOT = Path(__file__).resolve().parent.parent
PEERS = ROOT / "benchmarks" / "peers"
KEYS = {"peer", "version", "problem", "setting", "unknowns", "L1", "seconds", "minimum", "mass"}
ALWAYS = ("ours.py", "peer_chebyshev.py", "peer_chang_cooper.py", "peer_scikit_fem.py")
OTHERS = {"ngsolve": "peer_ngsolve.py", "fipy": "peer_fipy.py"}


def run(*arguments):
    command = [sys.executable, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


@pytest.mark.parametrize(
    "script",
    [s if "chebyshev" in s else pytest.param(s, marks=pytest.mark.slow) for s in ALWAYS],
)
def test_smallest_settings_print_measurements(script):
    done = run(str(PEERS / script), "--smallest")
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert {"W1", "W2", "W3", "W4"} <= {line["problem"] for line in lines}
    for line in lines:
        assert set(line) == KEYS | {"note"}
        # With mass one on both sides ∫|p_h − p| <= 2 unless p_h is negative; all are far below.
        assert 0.0 < line["L1"] < 0.1
        assert abs(line["mass"] - 1.0) < 1e-6
        assert line["seconds"] > 0.0 and line["unknowns"] > 0


def test_the_density_of_the_coupled_problem_is_stationary():
    """E[s · ∇v + ½ b : ∇∇v] = 0 for every v, here monomials; not so without b_12."""
    problem = runpy.run_path(str(PEERS / "coupled.py"))["Mixture"]("W3")
    H, w = (a.ravel() for a in panel_rule(np.linspace(0.0, 60.0, 61), 16))
    at = np.array([a.ravel() for a in np.meshgrid(H, H, indexing="ij")])
    x, y = at
    p = np.outer(w, w).ravel() * problem.exact(at)
    (s, t), (b, d), divergence = problem.coefficients(at)
    c = problem.cross(at)
    of = problem.process
    full = of.coefficients(at.T).diffusion
    assert np.array_equal(np.moveaxis(full, 0, -1), [[b, c], [c, d]])
    assert np.array_equal(of.coefficients(at.T).drift.T, [s, t])
    assert np.array_equal(of.coefficients(at.T).divergence.T, divergence)
    identities = (
        (s,), (t,), (2 * x * s, b), (2 * y * t, d), (y * s, x * t, c),
        (2 * x * y * s, x**2 * t, y * b, 2 * x * c),
    )  # fmt: skip
    # Round-off of a sum of 960² numbers, as a random walk: 960 eps = 2e-13 of their sizes.
    assert abs(p.sum() + problem.tail((60.0, 60.0)) - 1.0) < 2e-13
    for terms in identities:
        assert abs(p @ sum(terms)) < 2e-13 * sum(p @ np.abs(term) for term in terms)
    *rest, _ = identities[4]
    assert abs(p @ sum(rest)) > 0.1 * sum(p @ np.abs(term) for term in rest)


def test_probability_circulates_in_the_coupled_problem():
    """The slopes of ln p that fit no flux, b⁻¹ (2s − ∇·b), are no gradient."""
    process = runpy.run_path(str(PEERS / "coupled.py"))["Mixture"]("W3").process

    def slope(x: float, y: float) -> np.ndarray:
        at = np.array([[x, y]])
        flow = 2.0 * process.at(at).drift - process.at(at).divergence
        return np.linalg.solve(process.at(at).diffusion[0], flow[0])

    curl = slope(1.001, 0.8)[1] - slope(0.999, 0.8)[1]
    curl -= slope(1.0, 0.801)[0] - slope(1.0, 0.799)[0]
    assert abs(curl / 0.002) > 0.1


def test_the_peers_get_the_coefficients_of_the_scene(monkeypatch):
    monkeypatch.syspath_prepend(PEERS)
    problem = runpy.run_path(str(PEERS / "vanderpol.py"))["Averaged"]("W4", "vanderpol")
    at = np.array([[0.0, 0.02, 0.3], [0.1, 0.4, 0.05]])
    drift, diffusion, divergence = problem.coefficients(at)
    np.testing.assert_allclose(drift, problem.process.at(at.T).drift.T, rtol=1e-13, atol=1e-16)
    full = np.moveaxis(problem.process.at(at.T).diffusion, 0, -1)
    np.testing.assert_allclose(full, [[diffusion[0], 0.0 * at[0]], [0.0 * at[0], diffusion[1]]])
    np.testing.assert_allclose(divergence, problem.process.at(at.T).divergence.T)


@pytest.mark.parametrize(
    "module", [m if m == "fipy" else pytest.param(m, marks=pytest.mark.slow) for m in OTHERS]
)
def test_a_missing_peer_is_named(module):
    if find_spec(module):
        pytest.skip(f"{module} is installed")
    done = run(str(PEERS / OTHERS[module]), "--smallest")
    assert done.returncode == 3
    assert f"missing: {module}" in done.stderr


def run_code(code):
    done = run("-c", f"import sys; sys.path[:0] = {[str(PEERS), str(PEERS.parent)]!r}\n{code}")
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_page_names_who_is_missing(tmp_path):
    page = tmp_path / "peers.md"
    only = ("--smallest", "--only", "Chang-Cooper", "--out", str(page))
    done = run(str(PEERS / "run.py"), *only)
    assert done.returncode == 0, done.stderr
    for section in ("In short", "Failures", "Omissions", "All measurements"):
        assert f"## {section}" in page.read_text()
    empty = "from page import written\nprint(written([], {'FiPy': 'not installed'}))"
    assert "FiPy: not installed." in run_code(empty)


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


def test_the_page_in_the_repository_has_the_rows_that_the_scripts_write():
    run_code(
        "from page import PROGRAMS\n"
        "from measured_tables import page_blocks, structure\n"
        "header, rows = structure(page_blocks()['cost'])\n"
        "assert len(header) == 7 and rows == list(PROGRAMS.values()), rows"
    )
