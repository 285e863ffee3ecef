"""The commands about motion in the stationary state: crossings, spectrum, relaxation."""

from collections.abc import Callable
from time import perf_counter
from typing import Any

import click

from cases.commands import parts
from cases.scene.errors import BadInput
from fpk.errors import NotApplicable

LIST = '"-1.5:1.5:0.1", "-1,0,0.3".'


def _question(command: Any) -> Any:
    """Add what all three commands take."""
    options = (
        parts.scene_name,
        click.option("--method", required=True, help="exact, linear or phase-space."),
        click.option("--solver", help="One of the solvers of the method."),
        click.option(
            "--tol", type=float, help="Relative error wanted; a solver adapts to meet it."
        ),
        parts.as_json,
    )
    for option in reversed(options):
        command = option(command)
    return command


def _of_displacement(command: Any) -> Any:
    """Add a displacement and a list of points."""
    of = click.option("--of", metavar="OBS", required=True, help="A displacement: q1, q2, ...")
    return of(click.option("--at", metavar="LIST", required=True, help=LIST)(command))


@click.command()
@_question
@_of_displacement
def crossings(**settings: Any) -> None:
    """Give the upcrossings of levels per unit time in the stationary state."""
    from fpk.dynamics import Crossings

    _curve(Crossings, "crossings", "rate", **settings)


@click.command()
@_question
@_of_displacement
def spectrum(**settings: Any) -> None:
    """Give the power spectral density at angular frequencies.

    It is two-sided: its integral over all frequencies, negative ones too, is the variance.
    """
    from fpk.dynamics import Spectrum

    _curve(Spectrum, "spectrum", "spectrum", **settings)


@click.command()
@_question
@click.option("--rates", type=click.IntRange(1, 100), default=5, help="How many; default 5.")
def relaxation(scene: str, method: str, solver: str | None, rates: int, tol: float | None) -> None:
    """Give the slowest rates at which the system forgets its past.

    They are the real parts of eigenvalues, beside the imaginary parts, angular frequencies; of a
    conjugate pair one is listed.
    """
    loaded = parts.checked(scene, tol=tol)
    from cases.output.records import rates_record, rates_text
    from fpk.dynamics import Relaxation

    asked = _method_giving(Relaxation, "relaxation rates", method, solver)
    answer, seconds = _answered(
        loaded.name,
        method,
        lambda progress: asked.relaxation(loaded.system, rates, tol=tol, progress=progress),
    )
    record = rates_record(loaded, asked, answer, seconds)
    parts.end(record, lambda: rates_text(record), problems=_problems("relaxation", record))


def _curve(
    kind: Any,
    question: str,
    key: str,
    *,
    scene: str,
    method: str,
    solver: str | None,
    of: str,
    at: str,
    tol: float | None,
) -> None:
    loaded = parts.checked(scene, tol=tol)
    observable = parts.observable_of(of, loaded)
    from cases.output.records import curve_record, curve_text
    from cases.scene.points import parse_points

    if len(observable) != 1 or observable[0].kind != "q":
        remedy = f"use a displacement, q1..q{loaded.system.n}"
        raise BadInput(f'--of "{of}": {question} is of one displacement; {remedy}')
    (points,) = parse_points(at, 1)
    asked = _method_giving(kind, question, method, solver)
    row = observable[0].row
    answer, seconds = _answered(
        loaded.name,
        method,
        lambda progress: getattr(asked, question)(
            loaded.system, row, points, tol=tol, progress=progress
        ),
    )
    record = curve_record(loaded, asked, observable, points, key, answer, seconds)
    problems = _problems(f"{question} of {of}", record)
    parts.end(record, lambda: curve_text(record, key), problems=problems)


def _method_giving(kind: Any, question: str, name: str, solver: str | None) -> Any:
    """Return the method ``name`` if it is one of the ``kind``; refuse it where it is not."""
    from cases.comparison.routes import listed_routes, method_for

    method = method_for(name, solver)
    if not isinstance(method, kind):
        able = dict.fromkeys(r.method for r in listed_routes() if isinstance(r.make(), kind))
        raise BadInput(f"{name} gives no {question}; use one of {', '.join(able)}")
    return method


def _answered(scene: str, method: str, work: Callable[[Any], Any]) -> tuple[Any, float]:
    """Return what ``work`` returns and the seconds that it took, under a bar of progress."""
    from cases.output.bar import progress_bar

    start = perf_counter()
    try:
        with progress_bar() as progress:
            answer = work(progress)
    except NotApplicable as reason:
        raise BadInput(f"{scene}: {method} does not apply: {reason}") from None
    return answer, perf_counter() - start


def _problems(what: str, record: dict[str, Any]) -> list[str]:
    return [f"{what} is not certified: {words}" for words in record["certificate"]["failures"]]
