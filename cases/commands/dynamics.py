"""The commands about motion in the stationary state."""

from typing import Any

import click

from cases.commands import parts
from cases.commands.questions import LIST, answer_of, problems_of, question
from cases.scene.errors import BadInput


def _of_displacement(command: Any) -> Any:
    """Add a displacement, a list of points, and what a simulation takes."""
    of = click.option("--of", metavar="OBS", required=True, help="A displacement: q1, q2, ...")
    at = click.option("--at", metavar="LIST", required=True, help=LIST)
    return of(at(parts.seed(parts.seconds(parts.threads(command)))))


@click.command()
@question
@_of_displacement
def crossings(**settings: Any) -> None:
    """Give the upcrossings of levels per unit time in the stationary state.

    By linear, exact or phase-space, or counted in a simulation by montecarlo.
    """
    from fpk.dynamics import Crossings

    _curve(Crossings, "crossings", "rate", **settings)


@click.command()
@question
@_of_displacement
def spectrum(**settings: Any) -> None:
    """Give the power spectral density at angular frequencies.

    It is two-sided: its integral over all frequencies, negative ones too, is the variance. By
    linear or phase-space, or estimated from a simulation by montecarlo.
    """
    from fpk.dynamics import Spectrum

    _curve(Spectrum, "spectrum", "spectrum", **settings)


@click.command()
@question
@_of_displacement
def correlation(**settings: Any) -> None:
    """Give the autocovariance E q(0) q(t) − (E q)² at lags t >= 0.

    It begins with the variance. By linear or phase-space, or estimated from a simulation by
    montecarlo.
    """
    from fpk.dynamics import Correlation

    _curve(Correlation, "correlation", "correlation", **settings)


@click.command()
@question
@click.option("--rates", type=click.IntRange(1, 100), default=5, help="How many; default 5.")
def relaxation(scene: str, method: str, solver: str | None, rates: int, tol: float | None) -> None:
    """Give the slowest rates at which the system forgets its past.

    They are the real parts of eigenvalues, beside the imaginary parts, angular frequencies; of a
    conjugate pair one is listed.
    """
    loaded = parts.checked(scene, tol=tol)
    from cases.output.records import rates_record, rates_text
    from fpk.dynamics import Relaxation

    answered = answer_of(
        (Relaxation, "relaxation rates", loaded.name, method, solver),
        lambda asked, progress: asked.relaxation(loaded.system, rates, tol=tol, progress=progress),
    )
    record = rates_record(loaded, *answered)
    parts.end(record, lambda: rates_text(record), problems=problems_of("relaxation", record))


def _curve(
    kind: Any,
    asks: str,
    key: str,
    *,
    scene: str,
    method: str,
    solver: str | None,
    of: str,
    at: str,
    tol: float | None,
    **simulation: Any,
) -> None:
    loaded = parts.checked(scene, tol=tol)
    observable = parts.observable_of(of, loaded)
    from cases.output.records import curve_record, curve_text
    from cases.scene.points import parse_points

    if len(observable) != 1 or observable[0].kind != "q":
        remedy = f"use a displacement, q1..q{loaded.system.n}"
        raise BadInput(f'--of "{of}": {asks} is of one displacement; {remedy}')
    (points,) = parse_points(at, 1)
    row = observable[0].row
    asked, answer, seconds = answer_of(
        (kind, asks, loaded.name, method, solver),
        lambda asked, progress: getattr(asked, asks)(
            loaded.system, row, points, tol=tol, progress=progress
        ),
        **simulation,
    )
    record = curve_record(loaded, asked, observable, points, key, answer, seconds)
    problems = problems_of(f"{asks} of {of}", record)
    parts.end(record, lambda: curve_text(record, key), problems=problems)
