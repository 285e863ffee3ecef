"""Files, names, commands and constants that the documents mention are those of the program."""

import ast
import re
import runpy
import shlex
from pathlib import Path

import pytest

from averaging import Exact, Integrable, Linear, NonIntegrable, PhaseSpace, theory
from averaging.modal.time import questions
from averaging.phase_space import method as phase_space
from averaging.phase_space import refinement
from averaging.phase_space.dynamics import resolvent
from averaging.phase_space.passage import first_passage, mesh
from cases.commands.app import app
from cases.comparison import answering, claims
from cases.comparison.routes import listed_routes
from cases.output import vtk
from cases.scene import schema
from cases.studies.sweep import reference
from fpk import clearance, damping
from sim import checkpoint, diagnostics, step_size, substeps
from sim.motion import correlation, failure_times, spectrum
from sim.splitting import estimate

ROOT = Path(__file__).parent.parent
THEORY = ROOT / "docs" / "theory.md"
DOCUMENTS = [*sorted((ROOT / "docs").glob("**/*.md")), ROOT / "CONTRIBUTING.md", ROOT / "README.md"]
REFERENCE = re.compile(r"([a-z_0-9/]+\.py)::(\w+)(?:\.(\w+))?")
FILE = re.compile(r"`((?:fpk|averaging|sim|cases|tests|docs|examples)/[\w/.-]*)`")


def names_in(source):
    """Functions, classes and constants of a module, and the methods of its classes."""
    nodes = list(ast.walk(ast.parse(source)))
    assigned = [
        target
        for n in nodes
        if isinstance(n, ast.Assign | ast.AnnAssign)
        for target in (n.targets if isinstance(n, ast.Assign) else [n.target])
    ]
    names = {n.id for target in assigned for n in ast.walk(target) if isinstance(n, ast.Name)}
    return names | {n.name for n in nodes if hasattr(n, "name")}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_names_in_documents_exist(document):
    for file, *names in REFERENCE.findall(document.read_text(encoding="utf-8")):
        path = ROOT / file
        assert path.is_file(), f"{document.name} mentions {file}"
        there = names_in(path.read_text(encoding="utf-8"))
        assert {*filter(None, names)} <= there, f"{file} has not all of {names}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_files_in_documents_exist(document):
    for file in FILE.findall(document.read_text(encoding="utf-8")):
        assert (ROOT / file).exists(), f"{document.name} mentions {file}"


def test_the_theory_names_code():
    assert THEORY in DOCUMENTS
    assert len(REFERENCE.findall(THEORY.read_text(encoding="utf-8"))) > 25


def test_the_command_line_page_has_every_method_and_solver():
    page = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    rows = [line.split("|") for line in page.split("\n") if line.startswith("| `")]
    solvers = {row[1].strip(): row[3] for row in rows if len(row) == 5}
    routes = listed_routes()
    assert routes
    for route in routes:
        assert f"`{route.solver}`" in solvers[f"`{route.method}`"], route.label


def commands_in(text):
    """Commands in the blocks of a shell and of a console, without their comments."""
    shell = "\n".join(re.findall(r"```sh\n(.*?)```", text, flags=re.DOTALL))
    console = "\n".join(re.findall(r"```console\n(.*?)```", text, flags=re.DOTALL))
    shell += "\n" + "\n".join(re.findall(r"^\$ (.*)", console, flags=re.MULTILINE)).replace(
        " && ", "\n"
    )
    lines = shell.replace("\\\n", " ").split("\n")
    calls = [line.split(" > ")[0] for line in lines if line.startswith("fpk ")]
    return [shlex.split(call, comments=True)[1:] for call in calls]


def test_commands_in_documents_parse():
    found = [c for path in DOCUMENTS for c in commands_in(path.read_text(encoding="utf-8"))]
    assert len(found) > 20
    for name, *arguments in found:
        with app.commands[name].make_context(name, arguments):
            pass


def test_the_readme_is_short_with_three_commands_and_how_long_they_take():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(readme.split("\n")) <= 105
    first = re.findall(r"```console\n\$ (.*)\n", readme)
    assert len(first) == 3 and all(re.search(r"  # [\d.]+ s$", line) for line in first)


def test_the_readme_has_the_figures_of_the_pages(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    table = runpy.run_path(str(ROOT / "benchmarks" / "readme.py"))["trust_table"]()
    assert table in (ROOT / "README.md").read_text(encoding="utf-8")


def short(number):
    """The number as documents write a tolerance: 1e-4."""
    return f"{number:.0e}".replace("e-0", "e-")


DYNAMICS = ", ".join(
    map(short, (phase_space.CROSSINGS_TOL, phase_space.SPECTRUM_TOL, phase_space.CORRELATION_TOL))
)

CONSTANTS = {
    "choose.md": (
        f"| tolerance of deterministic densities | {short(theory.SMALLEST)} to {theory.LARGEST} |",
        f"| masses of a scene | {schema.MAX_MASSES} |",
        f"| masses in `phase-space` | {phase_space.MOST_MASSES}, stops on 1 of them,",
        f"| degree of a damping term | {damping.MOST_POWERS}, an energy counting 2 |",
        f"by plain simulation | {answering.LEAST_FAILURES:g} failures of the paths expected |",
        f"clearance > {clearance.CLEARANCE_RULE:g} rms",
        f"({refinement.MEMORY:g} GB, `--memory`)",
        f"at a false-alarm rate of {short(diagnostics.FALSE_ALARMS)}.",
    ),
    "command-line.md": (
        f"at a false-alarm rate of {short(diagnostics.FALSE_ALARMS)} an observable",
        f"to {short(PhaseSpace().tol)} by default",
        f"as long as a solution needs at most {refinement.MEMORY:g} GB",
        f"for `phase-space` {DYNAMICS} and {short(phase_space.RELAXATION_TOL)} if left out",
        f"to {short(first_passage.TOL)} (H) or"
        f" {short(first_passage.GLANCING_TOL)} (a displacement)",
        f"of `fem` {short(NonIntegrable().tol)}, with two energies {short(questions.TOL)},",
        f"solved to {short(reference.REFERENCE_TOL)}",
        f"within {short(vtk.SUBDIVISION)} of the largest density",
        f"is at least {short(vtk.CUT)} of its maximum",
    ),
    "cluster.md": (f"Every {checkpoint.INTERVAL:g} seconds of a simulation",),
    "scene.md": (
        f"(a false-alarm rate of {short(diagnostics.FALSE_ALARMS)}, over all times)",
        f"up to {schema.MOST_QUESTIONS} of each",
        f"up to {schema.MOST_LEVELS} levels a coordinate",
        f"their sum is at most {damping.MOST_POWERS} (an energy counts two)",
        f"fewer than {answering.LEAST_FAILURES:g} failures of the paths",
        f"within {claims.ALMOST_L1} in L1 of the Gaussian",
        f"excess kurtosis of at most {claims.ALMOST_KURTOSIS}",
    ),
    "theory.md": (
        f"about ${step_size.BIAS}\\,X^e$ of itself",
        f"each pair of normals lies in a disc of radius {substeps.LARGEST_NORMAL:.2f}",
        f"Above {100 * estimate.RESOLVED:g} % no error is stated",
        f"the error is {refinement.SAFETY:g} d",
        f"r at least {refinement.SLOWEST}",
        f"and {refinement.FIRST * refinement.SAFETY:g} d after two solutions",
        f"less than {refinement.KEPT} of the one before",
        f"a damping ratio below {refinement.LIGHT} it is not",
        f"less than {refinement.KEPT_WHERE_LIGHT} of the one before",
        f"{refinement.COMMON} of the largest",
        f"from {resolvent.BLOCK} random vectors",
        f"Velocities are followed {mesh.BEYOND} kicks of noise",
        f"{first_passage.SAFETY:g} times the distance of the last two,"
        f" or {first_passage.SAFETY * first_passage.SHARE:g} times the largest relative one",
        f"A mean time beyond e^{first_passage.HIGHEST:g} units",
        f"with fewer than {failure_times.LEAST_FAILURES} failures in the tail",
        f"jackknife of {failure_times.GROUPS} groups",
        f"one Hann window of {spectrum.WINDOW:g} decay times",
        f"over paths and {correlation.RELAXATIONS:g} relaxation times",
    ),
}
"""What documents say of constants of the code, made from these."""


@pytest.mark.parametrize("page", CONSTANTS)
def test_constants_in_documents_are_those_of_the_code(page):
    text = " ".join((ROOT / "docs" / page).read_text(encoding="utf-8").split())
    for phrase in CONSTANTS[page]:
        assert phrase in text


def test_tolerances_of_the_methods_are_their_defaults():
    page = (ROOT / "docs" / "choose.md").read_text(encoding="utf-8")
    rows = [line.split(" | ") for line in page.split("\n") if line.startswith("| `")]
    stated = {row[0].strip("| `"): row[-1].removesuffix(" |") for row in rows}
    for method in (Exact, Linear, NonIntegrable, Integrable, PhaseSpace):
        assert stated[method().route.method] == short(method().tol)


def test_the_version_to_cite_is_that_of_the_program():
    for file, pattern in (
        ("docs/cite.md", r"version = \{(.*?)\}"),
        ("CITATION.cff", r"\nversion: (.*)"),
    ):
        (stated,) = re.findall(pattern, (ROOT / file).read_text(encoding="utf-8"))
        assert f'version = "{stated}"' in (ROOT / "pyproject.toml").read_text(encoding="utf-8"), (
            file
        )
