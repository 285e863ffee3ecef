"""Options, answers and problems of the commands other than ``fpk density`` that ask one method.

These are ``fpk transient``, ``passage``, ``crossings``, ``spectrum`` and ``relaxation``.
"""

from collections.abc import Callable
from time import perf_counter
from typing import Any

import click

from cases.commands import parts
from cases.scene.errors import BadInput
from fpk.errors import InvalidInput, NotApplicable

LIST = '"-1.5:1.5:0.1", "-1,0,0.3".'


def question(command: Any) -> Any:
    """Add the scene, the method, its solver and tolerance, and ``--json``."""
    options = (
        parts.scene_name,
        click.option("--method", required=True, help="One that gives it; others are refused."),
        click.option("--solver", help="One of the solvers of the method."),
        click.option(
            "--tol", type=float, help="Relative error wanted; a solver adapts to meet it."
        ),
        parts.as_json,
    )
    for option in reversed(options):
        command = option(command)
    return command


def simulated(command: Any) -> Any:
    """Add the seed, the wall time and the threads of a simulation."""
    return parts.seed(parts.seconds(parts.threads(command)))


def answer_of(
    asked: tuple[Any, str, str, str, str | None], work: Callable[[Any, Any], Any], **settings: Any
) -> tuple[Any, Any, float]:
    """Return the method, what ``work(method, progress)`` returns and the seconds that it took.

    ``asked`` names the protocol, the question in words, the scene, the method and its solver. Where
    no solver is given it is the first of the method that gives the answer. ``settings`` are those
    of ``simulated``, None where the user gave none. Raises ``BadInput`` for a method that has not
    the protocol or a setting that was given, or with the first reason why it does not apply.
    """
    from cases.comparison.routes import listed_routes, methods_of, require_settings
    from cases.output.bar import progress_bar

    kind, words, scene, name, solver = asked
    try:
        methods = [m for m in methods_of(name, solver, **settings) if isinstance(m, kind)]
        for method in methods[:1]:
            require_settings(method, name, settings)
    except InvalidInput as error:
        raise _refused(error) from None
    if not methods:
        able = dict.fromkeys(r.method for r in listed_routes() if isinstance(r.make(), kind))
        raise BadInput(f"{name} gives no {words}; use one of {', '.join(able)}")
    start, reasons = perf_counter(), []
    for method in methods:
        try:
            with progress_bar() as progress:
                return method, work(method, progress), perf_counter() - start
        except NotApplicable as reason:
            reasons.append(str(reason))
        except InvalidInput as error:
            raise _refused(error) from None
    raise BadInput(f"{scene}: {name} does not apply: {reasons[0]}")


def _refused(error: InvalidInput) -> BadInput:
    return BadInput(f"--{error.key.removeprefix('--')} {error.value}: {error.remedy}")


def problems_of(what: str, record: dict[str, Any]) -> list[str]:
    """Return what its certificate says against the answer, each in one line."""
    return [f"{what} is not certified: {words}" for words in record["certificate"]["failures"]]
