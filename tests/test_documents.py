"""Files, names, commands and constants that the documents mention are those of the program."""

import ast
import math
import re
import runpy
import shlex
from functools import cache
from pathlib import Path

import pytest

from averaging import Exact, Integrable, Linear, NonIntegrable, PhaseSpace, theory
from averaging.phase_space import method as phase_space
from averaging.phase_space import refinement, resolvent
from averaging.phase_space.equation import chain
from averaging.phase_space.plane import elements, first_passage
from averaging.time import MODAL_TOL
from cases.command import studies
from cases.command.app import app
from cases.compare import claims, doubt, quantity
from cases.compare.routes import all_routes
from cases.scene import schema
from cases.show import facts
from cases.show.pictures import densities
from cases.show.presented import PresentedAnswers
from cases.study import converge, cost, levels, orders
from cases.study.orders import grid_convergence
from cases.study.sweep import answering as sweep_answering
from fpk.answer import bins, contacts, quantities
from fpk.numeric.arrays import EPS
from fpk.numeric.errors import InvalidInput
from fpk.solvers.line.time.resolvent import CONTOUR_TIMES
from fpk.system import damping
from sim.montecarlo import MonteCarlo
from sim.questions import curves, passage
from sim.questions.splitting import run as splitting
from sim.sample import diagnostics, histogram, plan, workers
from sim.step import step_size

ROOT = Path(__file__).parent.parent
THEORY = ROOT / "docs" / "theory.md"
DOCUMENTS = [*sorted((ROOT / "docs").glob("**/*.md")), ROOT / "CONTRIBUTING.md", ROOT / "README.md"]
REFERENCE = re.compile(r"([a-z_0-9/]+\.py)::(\w+)(?:\.(\w+))?")
FILE = re.compile(r"`((?:fpk|averaging|sim|cases|tests|docs|examples)/[\w/.-]*)`")


@cache
def names_in(source):
    """Functions, classes and constants of a module, and the methods of its classes."""
    nodes = list(ast.walk(ast.parse(source)))
    names = {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
    return names | {n.name for n in nodes if hasattr(n, "name")}


def test_names_and_files_in_documents_exist():
    assert THEORY in DOCUMENTS
    assert len(REFERENCE.findall(THEORY.read_text(encoding="utf-8"))) > 25
    for document in DOCUMENTS:
        text = document.read_text(encoding="utf-8")
        for file in (*FILE.findall(text), *(file for file, *_ in REFERENCE.findall(text))):
            assert (ROOT / file).exists(), f"{document.name} mentions {file}"
        for file, *names in REFERENCE.findall(text):
            there = names_in((ROOT / file).read_text(encoding="utf-8"))
            assert {*filter(None, names)} <= there, f"{file} has not all of {names}"


def test_the_command_line_page_has_every_method_and_solver():
    page = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    rows = [line.split("|") for line in page.split("\n") if line.startswith("| `")]
    solvers = {row[1].strip(): row[3] for row in rows if len(row) == 5}
    routes = all_routes()
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


def test_the_readme_is_short_with_three_commands_their_times_and_the_figures_of_the_pages(
    monkeypatch,
):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(readme.split("\n")) <= 105
    first = re.findall(r"```console\n\$ (.*)\n", readme)
    assert len(first) == 3 and all(re.search(r"  # [\d.]+ s$", line) for line in first)
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    assert runpy.run_path(str(ROOT / "benchmarks" / "readme.py"))["trust_table"]() in readme


def short(number):
    """The number as documents write a tolerance: 1e-4."""
    return f"{number:.0e}".replace("e-0", "e-")


DYNAMICS = ", ".join(
    map(short, (phase_space.CROSSINGS_TOL, phase_space.SPECTRUM_TOL, phase_space.CORRELATION_TOL))
)

WORDS, PARTS = {2: "two", 3: "three", 10: "ten"}, {4: "a quarter", 5: "a fifth"}

CONSTANTS = {
    "choose.md": (
        f"| tolerance of deterministic densities | {short(theory.SMALLEST)} to {theory.LARGEST} |",
        f"| masses of a scene | {schema.MAX_MASSES} |",
        f"| masses in `phase-space` | {phase_space.MOST_EXPANSION_MASSES}, stops on 1 of them,",
        f"| degree of a damping term | {damping.MOST_POWERS}, an energy counting 2 |",
        f"by plain simulation | {4 * passage.LEAST_TAIL_FAILURES} failures of the paths expected,"
        f" {passage.LEAST_TAIL_FAILURES} of them in the tail if some",
        f"clearance > {contacts.CLEARANCE_RULE:g} rms",
        f"({refinement.SOLUTION_MEMORY:g} GB, `--memory`)",
        f"up to {phase_space.MOST_EXPANSION_MASSES} masses, stops on one",
        f"at a false-alarm rate of {short(diagnostics.FALSE_ALARMS)}.",
    ),
    "command-line.md": (
        f"at a false-alarm rate of {short(diagnostics.FALSE_ALARMS)} an observable",
        f"Where that is off by more than {doubt.ACCEPTABLE_L1}, a stop",
        "quantiles of {0:.0%} and {2:.0%}".format(*quantity.QUANTILES.values()).replace("%", " %"),
        f"{short(PhaseSpace.tol)} or better where that is met",
        f"Where less than {short(0.1 * theory.LARGEST)} is out of reach",
        f"`--tol` below {short(PhaseSpace.tol)} does not reach it",
        f"applies to at most {WORDS[phase_space.UNASKED_MASSES]} masses",
        f"up to {WORDS[phase_space.MOST_EXPANSION_MASSES]} masses, stops on one of them",
        f"With more than {WORDS[facts.MASSES]} masses",
        f"simulation {PARTS[round(MonteCarlo().relaxations / studies.USUAL)]} as long",
        f"to {short(PhaseSpace().tol)} by default",
        f"as long as a solution needs at most {refinement.SOLUTION_MEMORY:g} GB",
        f"for `phase-space` {DYNAMICS} and {short(phase_space.RELAXATION_TOL)} if left out",
        f"to {short(first_passage.TOL)} (H) or"
        f" {short(first_passage.GLANCING_TOL)} (a displacement or velocity)",
        f"of `fem` {short(theory.DEFAULT)}, with two energies {short(MODAL_TOL)},",
        f"judged by an L1 error of {short(theory.DEFAULT)}, of systems with",
        f"stops on more than two masses by {short(theory.DEFAULT_BY_LINES)}.",
        f"solved to {short(sweep_answering.REFERENCE_TOL)}",
        f"within {short(quantities.SUBDIVISION)} of the largest density",
        f"is at least {short(quantities.FIELD_CUT)} of its maximum",
    ),
    "cluster.md": (f"Every {workers.INTERVAL:g} seconds of a simulation",),
    "faq.md": (f"gives it to {short(PhaseSpace.tol)} or better",),
    "scene.md": (
        f"within {doubt.ACCEPTABLE_L1} in L1 of the full system",
        f"(a false-alarm rate of {short(diagnostics.FALSE_ALARMS)}, over all times)",
        f"up to {schema.MOST_QUESTIONS} of each",
        f"up to {schema.MOST_LEVELS} levels a coordinate",
        f"their sum is at most {damping.MOST_POWERS} (an energy counts two)",
        f"expects fewer than {4 * passage.LEAST_TAIL_FAILURES} failures",
        f"within {claims.ALMOST_L1} in L1 of the Gaussian",
        f"excess kurtosis of at most {claims.ALMOST_KURTOSIS}",
    ),
    "theory.md": (
        f"about ${step_size.BIAS}\\,X^e$ of itself",
        f"up to about ${step_size.JOINT_BIAS}\\,X$ of itself",
        f"each pair of normals lies in a disc of radius {plan.LARGEST_NORMAL:.2f}: `sim/sample/",
        f"$a \\ge {plan.LARGEST_NORMAL:.2f}\\,\\sigma(H)$",
        f"clearance > {contacts.CLEARANCE_RULE:g} rms",
        f"one serves all times within a factor {CONTOUR_TIMES:g}",
        f"Above {100 * splitting.LARGEST_SPREAD:g} % no error is stated",
        f"the error is {refinement.DISTANCE_SAFETY:g} d",
        f"r at least {refinement.SLOWEST_FALL}",
        f"and {refinement.FIRST_SAFETY * refinement.DISTANCE_SAFETY:g} d after two solutions",
        f"less than {refinement.LEAST_RATIO} of the one before",
        f"by (2n/N − 1)⁶ times {chain.ABSORPTION:g} of the largest natural frequency",
        f"or to {refinement.HOPELESS} if that is larger",
        f"by a factor of {refinement.LIKELY_FALL:g} with each further solution",
        f"{refinement.LEAST_SHARE} of the largest",
        f"from {resolvent.BLOCK} random vectors",
        f"Energies rise until it is below {elements.RELIABILITY_SHARE:g} of the tolerance",
        f"{first_passage.DISTANCE_FACTOR:g} times the distance of the last two,"
        f" or {first_passage.DISTANCE_FACTOR * first_passage.CHANCE_SHARE:g} times the largest"
        " relative one",
        f"A mean time beyond e^{-math.log(EPS):.0f} units",
        f"with fewer than {passage.LEAST_TAIL_FAILURES} failures in the tail",
        f"jackknife of {passage.MAX_BATCHES} groups",
        f"one Hann window of {2.0 * curves.RECORD_TIMES:g} decay times",
        f"over paths and {curves.RECORD_TIMES:g} relaxation times",
        f"polynomial of total degree {bins.MAX_FIT_DEGREE} in the number of the bin",
        f"A box whose {bins.TESTED_DEGREES[1]} highest coefficients differ from 0",
        f"with a probability below {bins.DOUBT:g} is cut in two",
        f"and the probability is below {short(bins.ALARM)}",
        f"ln p changes by more than {bins.STEEPEST:g} from bin to bin",
        f"Bins end where the contact energy is {histogram.DEEPEST:g} kT",
    ),
}
"""What documents say of constants of the code, made from these."""


@pytest.mark.parametrize("page", CONSTANTS)
def test_constants_in_documents_are_those_of_the_code(page):
    parts = [ROOT / "docs" / page]
    if page == "command-line.md":
        parts += sorted((ROOT / "docs" / "commands").glob("*.md"))
    text = " ".join(" ".join(part.read_text(encoding="utf-8") for part in parts).split())
    for phrase in CONSTANTS[page]:
        assert phrase in text


FOLDER = ROOT / "cases" / "show" / "templates"
TEMPLATES = [*FOLDER.glob("*.html"), *FOLDER.glob("*.txt")]
NAMES = r"Eq\. \(1\)|condition \(8\)|section 6\.3|\bL1\b|dt/2|\|∫p − 1\||\(2 ω_m\)"
NAMES += f"|negligible beyond {contacts.CLEARANCE_RULE:g} rms"
"""Digits of templates that are names, or of mathematics, or held to the code here."""


def test_a_template_repeats_no_constant():
    """What a text or page says of a constant of the program is filled in from the program."""
    assert len(TEMPLATES) > 6
    for path in TEMPLATES:
        text = path.read_text(encoding="utf-8")
        text = re.sub(r"\{%.*?%\}|\{\{.*?\}\}|\{#.*?#\}", "", text, flags=re.DOTALL)
        text = re.sub(r"<(style|pre).*?</\1>|<[^>]*>", "", text, flags=re.DOTALL)
        if path.name != "origin.html":  # citations
            assert not re.findall(r".{,40}\d.{,20}", re.sub(NAMES, "", text)), path.name
        rate = r"\b(one in|in a) (ten|hundred|thousand|million)|times the\b"
        assert not re.search(rate, text), path.name


def test_messages_and_help_state_the_limits_of_the_code():
    words = schema.REMEDIES["finite_number"]
    ends = [float(number) for number in re.findall(r"1e-?[0-9]+", words)]
    assert ends == [schema.SMALLEST, schema.LARGEST]
    limits = short(densities.LOG_TAIL), short(densities.SHOWN)
    assert (
        "down to {} of the largest, contours".format(*limits)
        in " ".join(PresentedAnswers.plot.__doc__.split())
        and f"to {limits[1]}." in PresentedAnswers.plot.__doc__
    )
    for command in app.commands.values():
        for option in command.params:
            if given := re.match(r"Default ([^.]+)\.", getattr(option, "help", None) or ""):
                assert given[1] == str(option.default)
    factors = [grid_convergence(x, theory=2.0, floor=0.0).safety
               for x in ((21.0, 6.0, 2.25, 1.3125), (2.0, 1.0, 0.5, 0.25))]  # fmt: skip
    trusted = f"within {100 * orders.TRUSTED:.0f} % of theory, else {factors[1]:g}"
    words = f"Safety factor {factors[0]:g} where the observed order is {trusted}"
    assert words in converge.GCI_WORDS
    assert f"within {WORDS[orders.ABOVE_FLOOR]} times the floor" in converge.ORDER_WORDS
    assert "the median of {} to {} runs".format(*levels.REPEATS) in cost.MEANING
    assert densities.LOG_TAIL == 1e-6  # "to a millionth of the top"
    tables = {key: field["schema"] for key, field in schema.SCENE["fields"].items()}
    assert f"within {doubt.ACCEPTABLE_L1} in L1" in str(tables["expect"]["fields"]["acceptable"])
    system = {key: [1.0] for key in tables["system"]["fields"]} | {"noise_gain": [[1.0]]}
    keys = tables["units"]["schema"]["fields"]
    with pytest.raises(InvalidInput) as refusal:
        schema.validate_scene({"system": system, "units": dict.fromkeys(keys, "1")})
    least, most = re.search(r"\{(\d+),(\d+)\}", schema.UNIT["pattern"]).groups()
    assert f"must be {least} to {most} letters" in refusal.value.remedy
    (memory,) = (o for o in app.commands["density"].params if o.name == "memory")
    assert f"{refinement.SOLUTION_MEMORY:g} if left out" in memory.help


def test_tolerances_of_the_methods_are_their_defaults():
    page = (ROOT / "docs" / "choose.md").read_text(encoding="utf-8")
    rows = [line.split(" | ") for line in page.split("\n") if line.startswith("| `")]
    stated = {row[0].strip("| `"): row[-1].removesuffix(" |") for row in rows}
    for method in (Exact, Linear, NonIntegrable, Integrable, PhaseSpace):
        assert stated[method().route.method] == short(method().tol or theory.DEFAULT)


def test_the_version_to_cite_is_that_of_the_program():
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    for file in ("docs/cite.md", "CITATION.cff"):
        text = (ROOT / file).read_text(encoding="utf-8")
        (stated,) = re.findall(r"\bversion(?: = \{|: )(0[\d.]+)", text)
        assert f'version = "{stated}"' in project, file
