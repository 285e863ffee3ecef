"""The commands about motion after a start: transient densities and first passage."""

from typing import Any

import click

from cases.commands import parts
from cases.commands.questions import answer_of, problems_of, question
from cases.scene.errors import BadInput
from fpk.errors import InvalidInput

LIST = '"-1.5:1.5:0.1", "-1,0,0.3", a pair "A x B".'
START = "rest (the default), H=0.3, H1=0.1,H2=0.2, q1=..,p1=..,.. or noise=0.5."

_start = click.option("--start", metavar="START", default="rest", help=START)


@click.command()
@question
@click.option("--of", metavar="OBS", required=True, help="H, q1.., p1.., H1.. or a pair a,b.")
@_start
@click.option("--times", metavar="LIST", required=True, help="Times after the start.")
@click.option("--at", metavar="LIST", required=True, help=LIST)
def transient(
    scene: str,
    method: str,
    solver: str | None,
    tol: float | None,
    of: str,
    start: str,
    times: str,
    at: str,
) -> None:
    """Give the density of an observable at times after a start."""
    loaded = parts.checked(scene, tol=tol)
    observable = parts.observable_of(of, loaded)
    from cases.output.records import transient_record, transient_text
    from cases.scene.points import parse_points
    from fpk.evolution import Transients
    from fpk.start import parse_start

    begin, points, later = (
        _read("start", start, lambda: parse_start(start, loaded.system)),
        parse_points(at, len(observable)),
        _times(times),
    )
    answered = answer_of(
        (Transients, "densities in time", loaded.name, method, solver),
        lambda asked, progress: asked.transient(
            loaded.system, observable, begin, later, points, tol=tol, progress=progress
        ),
    )
    record = transient_record(loaded, observable, begin, points, *answered)
    problems = problems_of(f"the density of {of}", record)
    parts.end(record, lambda: transient_text(record), problems=problems)


@click.command()
@question
@click.option("--limit", metavar="LIMIT", required=True, help="H=1.5, H1=0.4,H2=0.6 or q2=1.2.")
@_start
@click.option("--times", metavar="LIST", help="Times at which the reliability is given.")
def passage(
    scene: str,
    method: str,
    solver: str | None,
    tol: float | None,
    limit: str,
    start: str,
    times: str | None,
) -> None:
    """Give the first passage of a limit: moments of its time, failure rate, reliability.

    Where it is so rare by the last of the times that a plain simulation sees too few, montecarlo
    gives the reliability by multilevel splitting, and no more.
    """
    loaded = parts.checked(scene, tol=tol)
    from cases.comparison.rare import passage_answer
    from cases.output.records import passage_record, passage_text
    from cases.scene.questions import PassageQuestion
    from fpk.evolution import Passages
    from fpk.limit import parse_limit
    from fpk.start import parse_start

    begin = _read("start", start, lambda: parse_start(start, loaded.system))
    end = _read("limit", limit, lambda: parse_limit(limit, loaded.system.n))
    asked_of = PassageQuestion(end, begin, tuple(_times(times).tolist()))
    answered = answer_of(
        (Passages, "first passage", loaded.name, method, solver),
        lambda asked, progress: passage_answer(asked, loaded.system, asked_of, tol, progress),
    )
    record = passage_record(loaded, end, begin, *answered)
    parts.end(record, lambda: passage_text(record), problems=problems_of("first passage", record))


def _times(text: str | None) -> Any:
    """Return the times that ``text`` lists, none where there is no text."""
    import numpy as np

    from cases.scene.points import parse_points
    from fpk.evolution import checked_times

    if text is None:
        return np.zeros(0)
    (times,) = parse_points(text, 1, option="times")
    return _read("times", text, lambda: checked_times(times))


def _read(option: str, text: str, parse: Any) -> Any:
    """Return what ``parse`` makes of ``text``; raise ``BadInput`` naming the option."""
    try:
        return parse()
    except InvalidInput as error:
        raise BadInput(f'--{option} "{text}": {error.remedy}') from None
