"""The commands about motion after a start: transient densities and first passage."""

from typing import Any

import click

from cases.commands.asking import AT, SIMULATED, TOL, Asked, asking, observed
from cases.commands.parts import observable_of, read

START = click.option(
    "--start", metavar="START", default="rest",
    help="rest (the default), H=0.3, H1=0.1,H2=0.2, q1=..,p1=..,.. or noise=0.5.",
)  # fmt: skip


@asking(
    observed("H, q1.., p1.., H1.. or a pair a,b."),
    START,
    click.option("--times", metavar="LIST", required=True, help="Times after the start."),
    *(AT, TOL, *SIMULATED),
)
def transient(asked: Asked, of: str, start: str, times: str, at: str) -> None:
    """Give the density of an observable at times after a start."""
    system, observable = asked.scene.system, observable_of(of, asked.scene)
    from cases.output.records import columns_text, listed
    from cases.scene.points import parse_points
    from fpk.evolution import Transients
    from fpk.observable import observable_name
    from fpk.start import parse_start

    begin = read("start", start, lambda: parse_start(start, system))
    points, later = parse_points(at, len(observable)), _times(times)
    name = observable_name(observable)
    asked.reply(
        Transients,
        "densities in time",
        f"the density of {of}",
        {"observable": name, "start": str(begin), "points": listed(points)},
        lambda method, **how: method.transient(system, observable, begin, later, points, **how),
        columns_text,
        key="density",
    )


@asking(
    click.option("--limit", metavar="LIMIT", required=True, help="H=1.5, H1=0.4,H2=0.6 or q2=1.2."),
    START,
    click.option("--times", metavar="LIST", help="Times at which the reliability is given."),
    *(TOL, *SIMULATED),
)
def passage(asked: Asked, limit: str, start: str, times: str | None) -> None:
    """Give the first passage of a limit: moments of its time, failure rate, reliability.

    Where it is so rare that a plain simulation sees too few in all the time that it may take,
    montecarlo gives the reliability at the times by multilevel splitting, and no more.
    """
    from cases.comparison.rare import passage_answer
    from cases.output.records import passage_text
    from cases.scene.questions import PassageQuestion, require_below
    from fpk.evolution import Passages
    from fpk.limit import parse_limit
    from fpk.start import parse_start

    system = asked.scene.system
    begin = read("start", start, lambda: parse_start(start, system))
    end = read("limit", limit, lambda: parse_limit(limit, system.n))
    read("start", start, lambda: require_below(system, end, begin))
    question = PassageQuestion(end, begin, tuple(_times(times).tolist()))
    asked.reply(
        Passages,
        "first passage",
        "first passage",
        {"limit": str(end), "start": str(begin)},
        lambda method, **how: passage_answer(method, system, question, **how),
        passage_text,
    )


def _times(text: str | None) -> Any:
    """Return the times that ``text`` lists, none where there is no text."""
    import numpy as np

    from cases.scene.points import parse_points
    from fpk.evolution import checked_times

    if text is None:
        return np.zeros(0)
    (times,) = parse_points(text, 1, option="times")
    return read("times", text, lambda: checked_times(times))
