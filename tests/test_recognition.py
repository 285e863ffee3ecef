"""What is stored is recognised by every field of every record that it was made from.

The fields are found by themselves: one that is added tomorrow is changed here, too.
"""

from contextlib import suppress
from copy import copy
from dataclasses import fields, is_dataclass, replace
from functools import partial
from math import inf, isinf, nextafter
from pathlib import Path
from types import FunctionType

import click
import numpy as np
import pytest

import fpk
import sim.questions.splitting.kernel
import sim.step.kernel
from cases.command import parts
from cases.compare.quantity import parse_definition
from cases.compare.routes import all_routes
from cases.scene.errors import BadInput
from cases.scene.scene import load_scene
from fpk.answer.method import silent
from fpk.answer.names import parse_limit, parse_observable, parse_start
from fpk.numeric.errors import InvalidInput
from fpk.numeric.recognition import REGISTRY, canonical, fingerprint
from fpk.system.compiled_laws import compile_laws
from fpk.system.contact import Contact
from fpk.system.contact_law import LAWS
from fpk.system.damping import DampingTerm
from fpk.system.modulation import Modulation
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.questions.splitting.run import Splitting, sample_failure, system_problem
from sim.sample.histogram import Histogram, bin_axis
from sim.sample.plan import setup_of
from sim.sample.settings import ANYWHERE, NOT_IN_STATE
from sim.step.kernel import KernelKey

SYSTEM = System(
    [1.0, 2.0], [1.0, 3.0], [[0.2, 0.0], [0.0, 0.4]], [0.1, 0.2], [[1.0, 0.0], [0.0, 1.0]],
    contacts=(Contact(2, "both", 10.0, 0.5), Contact(1, "left", 4.0, 0.2, "power", 2.0)),
    damping_terms=(DampingTerm(1, 1, 0.3, q=((1, 2),), v=((2, 2),)),),
    modulation=Modulation([0.0, 1.0], [1.0, 0.5]),
)  # fmt: skip
STEADY = replace(SYSTEM, modulation=None, damping_terms=())
FOLLOWS = {
    "System.noise_matrix", "System.stiffness_matrix", "System._facts", "DampingTerm.degree",
}  # fmt: skip
"""Fields that are not compared, as they follow from others of their record."""


def changed(record, name, value):
    """The record with another value, not checked and with nothing else changed."""
    other = copy(record)
    object.__setattr__(other, name, value)
    return other


def others(value, registry=None):
    """Yield the fields on the way to it and the value with one number, text or entry changed."""
    if registry:
        yield (), next(name for name in registry if name != value)
    elif is_dataclass(value):
        name = type(value).__name__
        for f in fields(value):
            if not f.init:
                assert f"{name}.{f.name}" in FOLLOWS
                continue
            for way, other in others(getattr(value, f.name), f.metadata.get(REGISTRY)):
                yield (f"{name}.{f.name}", *way), changed(value, f.name, other)
    elif value is None:
        yield (), 0.25
    elif isinstance(value, bool):
        yield (), not value
    elif isinstance(value, int):
        yield (), value + 1
    elif isinstance(value, float):
        yield (), 1.0 if isinf(value) else nextafter(value, inf)
    elif isinstance(value, str):
        yield (), f"{value}x"
    elif isinstance(value, Path):
        yield (), value / "x"
    elif isinstance(value, np.ndarray):
        for k in (0, -1):
            other = value.copy()
            other.flat[k] = nextafter(other.flat[k], inf)
            yield (), other
    elif isinstance(value, dict):
        yield (), {**value, "more": 1.0}
        for key in value:
            yield from ((way, {**value, key: other}) for way, other in others(value[key]))
    elif isinstance(value, tuple):
        yield (), (*value, 7)
        for k, each in enumerate(value):
            yield from ((way, (*value[:k], other, *value[k + 1 :])) for way, other in others(each))
    else:
        assert isinstance(value, FunctionType | partial), f"how is {value!r} changed?"
        yield (), lambda *_: 0.0


def reading(value, less=()):
    """Hold that ``value`` is told from each change of it but of the fields in ``less``."""
    own, seen = fingerprint(value, less), set()
    assert own == fingerprint(copy(value), less)
    for way, other in others(value):
        assert (fingerprint(other, less) == own) == bool({*way} & {*less}), way
        seen |= {*way}
    return seen


def setup(**settings):
    method = MonteCarlo(time=5.0, **settings)
    own = setup_of(method, STEADY, [parse_observable("q2", 2)])
    axis = bin_axis(-1.0, 1.0, [0.5], 64, widening=True)
    return replace(
        own, system=SYSTEM, seconds=5.0, histograms=(Histogram(own.observables[0], (axis,)),)
    )


def test_every_field_of_every_record_is_compared():
    methods = [route.make() for route in all_routes()]
    limit, start = parse_limit("H1=0.5,H2=1", 2), parse_start("q1=0.1", SYSTEM)
    names = ("rms(q2)", "quantile(q2,0.9)", "mean_force(1,left)", "failure_rate(H=2)")
    asked = [parse_definition(name, SYSTEM) for name in names]
    seen = set()
    for record in (SYSTEM, setup(), Splitting(), *methods, limit, start, *asked, LAWS["hertz"]):
        seen |= reading(record)
    # Whoever adds to one of these has a reason why no number depends on it.
    where = {f"MonteCarlo.{name}" for name in ("threads", "cluster")}
    limits = {f"MonteCarlo.{name}" for name in ("checkpoint", "partial", "seconds", "longest")}
    numbers = ("threads", "cluster", "checkpoint", "partial", "repetitions", "tol", "seconds")
    of_splitting = {f"Splitting.{name}" for name in numbers}
    assert {*ANYWHERE} == where
    assert {*NOT_IN_STATE} == where | limits | of_splitting | {"Setup.seconds"}
    for less, record in ((ANYWHERE, MonteCarlo()), (NOT_IN_STATE, (setup(), Splitting()))):
        assert {*less} <= reading(record, less)  # a name that no field has leaves nothing out
    kinds = {name.partition(".")[0] for name in seen}
    assert {"Contact", "DampingTerm", "Modulation", "Scheme", "Histogram", "BinAxis", "Coordinate",
            "Definition", "ContactLaw", "AveragedSimulation"} <= kinds  # fmt: skip


def test_a_law_or_scheme_is_compared_by_what_it_is_not_by_its_name(monkeypatch):
    before = canonical(SYSTEM), compile_laws(("hertz",), "force")
    for way, law in others(LAWS["hertz"]):
        if way != ("ContactLaw.name",):
            with monkeypatch.context() as context:
                context.setitem(LAWS, "hertz", law)
                assert canonical(SYSTEM) != before[0], way
                if way == ("ContactLaw.force",):
                    assert compile_laws(("hertz",), "force") != before[1]
    assert (canonical(SYSTEM), compile_laws(("hertz",), "force")) == before


SCALE = 2.0


def test_functions_are_compared_by_their_code_and_the_numbers_in_it(monkeypatch):
    def scaled(by, *, most=1.0):
        return lambda x, least=0.0: min(max(by * x, least), most) * SCALE

    own = fingerprint(scaled(2.0))
    assert own == fingerprint(scaled(2.0)) != fingerprint(scaled(nextafter(2.0, 3.0)))
    assert own != fingerprint(scaled(2.0, most=2.0))
    assert fingerprint(partial(scaled(2.0), 1.0)) != fingerprint(partial(scaled(2.0), 2.0))
    assert fingerprint(fpk.Contact.force) != fingerprint(fpk.Contact.energy)
    monkeypatch.setitem(globals(), "SCALE", 3.0)
    assert own != fingerprint(scaled(2.0))
    with pytest.raises(InvalidInput, match="cannot be compared with what is stored"):
        fingerprint([object()])


def test_a_state_is_that_of_a_setup_equal_in_all_that_matters(tmp_path, monkeypatch):
    """A state is not gone on from under any other setting; where it is named, it is."""
    first = setup(checkpoint=tmp_path)
    saved = first.checkpoint()
    saved.save({"a": np.arange(3.0)})
    for way, other in others(first):
        state = other.checkpoint()
        again = replace(state, path=tmp_path / state.path.name).load()
        assert bool(again) == bool({*way} & {*NOT_IN_STATE}), way
    assert not replace(first, seconds=inf).checkpoint().load()
    assert first.checkpoint().load()
    monkeypatch.setattr("sim.sample.workers.program_checksum", lambda: 1)  # it was edited
    assert not first.checkpoint().load()


class Asked(Exception):
    """Ends a work where it asks for what is stored."""


def test_a_repetition_is_that_of_a_problem_equal_in_all_that_matters(monkeypatch):
    original = sim.questions.splitting.run.checkpoint_of

    def asked_for(folder, *about, **less):
        raise Asked(original(Path("any"), *about, **less).identity)

    def identity(problem, settings):
        with pytest.raises(Asked) as asked:
            sample_failure(problem, settings, silent)
        return str(asked.value)

    monkeypatch.setattr("sim.questions.splitting.run.checkpoint_of", asked_for)
    monkeypatch.setattr("sim.sample.workers.program_checksum", lambda: 1)
    limit, start = parse_limit("H=2", 2), parse_start("q1=0.1", STEADY)
    problem = system_problem(STEADY, limit, start, 5.0, dt=0.1, score=None)
    problem = replace(problem, system=SYSTEM, tables=problem.tables[:, ::32, ::32])
    own = identity(problem, Splitting())
    for way, other in others(problem):
        assert identity(other, Splitting()) != own, way
    for way, other in others(Splitting()):
        assert (identity(problem, other) == own) == (way[0] in NOT_IN_STATE), way


def of_points(simulation=None, folder=None, **settings):
    simulation = simulation or MonteCarlo(paths=4096, relaxations=5.0)
    system = System([1.0], [1.0], [0.2], [0.04])
    given = {"vary": {"system.noise_intensity[1]": [0.04, 0.05]}, "quantities": ["rms(q1)"],
             "methods": ["linear"], **settings}  # fmt: skip
    return fpk.sweep(given.pop("system", system), simulation=simulation, folder=folder, **given)


def test_points_are_those_of_a_sweep_equal_in_all_that_matters(tmp_path, monkeypatch):
    first = MonteCarlo(paths=4096, relaxations=5.0)
    assert of_points(first, tmp_path).reused == 0
    for way, other in others(first):
        if way[0] in ANYWHERE:
            assert of_points(other, tmp_path).reused == 2
            continue
        with pytest.raises(BadInput, match="another run"):
            of_points(other, tmp_path)
    for settings in (
        {"tol": 1e-6}, {"methods": ["exact"]}, {"methods": ["linear/closed-form"]},
        {"quantities": ["std(q1)"]}, {"quantities": ["quantile(q1,0.9)"]},
        {"reference": "phase-space"},
        {"system": System([1.0], [1.0], [nextafter(0.2, 1.0)], [0.04])},
    ):  # fmt: skip
        with pytest.raises(BadInput, match="another run"):
            of_points(None, tmp_path, **settings)
    # Where the time of a clock ends a simulation its result depends on the threads, too.
    timed = tmp_path / "timed"
    assert of_points(replace(first, seconds=1.0, threads=1), timed).reused == 0
    with pytest.raises(BadInput, match="another run"):
        of_points(replace(first, seconds=1.0, threads=2), timed)
    monkeypatch.setattr("cases.show.claim.program_checksum", lambda **_: 1)
    with pytest.raises(BadInput, match="version"):  # the program was edited
        of_points(first, tmp_path)


def test_an_option_of_a_command_is_another_run_unless_no_state_depends_on_it(tmp_path):
    @parts.simulation_options
    def command(**_):
        pass

    scene = load_scene("fig3a")
    names = [click.core.Option(p.opts).name for p in click.command()(command).params]
    own = {**dict.fromkeys(names), "checkpoint": tmp_path}
    for name in ("", *names):
        with suppress(BadInput), click.Context(click.Command("any")):
            parts.checkpoint_folder(scene, own if name in ("", "checkpoint") else {**own, name: 7})
            assert name in ("", "checkpoint") or f"MonteCarlo.{name}" in NOT_IN_STATE, name
            continue
        assert f"MonteCarlo.{name}" not in NOT_IN_STATE and name, name
    assert {"dt", "step_pair", "allow_unstable", "seed", "tol", "threads"} <= {*names}


UNREAD_BY_PATHS = {"kick_first", "moments", "substeps"}
"""Fields of a ``KernelKey`` that have one value where single paths are made for splitting."""


@pytest.mark.parametrize(
    ("compiled", "unread"),
    [(sim.step.kernel.kernel_for, set()),
     (lambda key: sim.questions.splitting.kernel.path_function_for(key, "H"), UNREAD_BY_PATHS)],
)  # fmt: skip
def test_compiled_code_is_found_by_every_field_of_its_key(compiled, unread):
    """The disk cache finds it by what it closes over."""

    def closed_over(key):
        return fingerprint([cell.cell_contents for cell in compiled(key).py_func.__closure__])

    key = KernelKey(laws=("hertz",), damping=True, energy_damping=True, energy=True)
    own = closed_over(key)
    for name, value in key._asdict().items():
        values = [other for _, other in others(value)]
        for other in [("power",), ()] if name == "laws" else values:
            assert (closed_over(key._replace(**{name: other})) == own) == (name in unread)
