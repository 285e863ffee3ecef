"""The commands about the stationary state, and about motion after a start.

Those about the motion of a displacement follow from their records in ``fpk.answer.question``.
"""

from dataclasses import replace
from typing import Any

import click

from cases.command import parts
from cases.command.asking import AT, LIST, MEMORY, SIMULATED, TOL, Asked, asking
from cases.scene.errors import BadInput
from fpk.answer.question import QUESTIONS, Question

DISPLACEMENT = (
    parts.of(required=True, help="A displacement: q1, q2, ..."),
    click.option("--at", metavar="LIST", required=True, help=f"{LIST}."),
    TOL,
    *SIMULATED,
    MEMORY,
)


@asking(
    parts.of(required=True, help="q1.., p1.., H, H1.. or a pair a,b."),
    AT,
    parts.simulation_options,
    MEMORY,
)
def density(asked: Asked, of: str, at: str) -> None:
    """Give one density at the points asked for."""
    observable = parts.observable_of(of, asked.scene)
    from cases.scene.points import parse_points
    from cases.show.records import point_list
    from fpk.answer.dynamics import Curve
    from fpk.answer.method import Method
    from fpk.answer.names import observable_name

    points, settings = parse_points(at, len(observable)), asked.settings
    parts.check_cluster(settings["cluster"])

    def work(method: Any, tol: float | None, progress: Any) -> Curve:
        loosened = tol is not None and not method.route.sampled and hasattr(method, "tol")
        taken: Method = replace(method, tol=tol) if loosened else method
        plan = taken.planned(asked.scene.system, [observable])
        parts.checkpoint_folder(asked.scene, {**settings, "tol": tol, "observable": of})
        result = taken.solve(asked.scene.system, [observable], plan=plan, progress=progress)
        (p,) = result.densities
        return Curve(*p.at(*points), p.certificate, result.settings, p.error_kind)

    given = {"observable": observable_name(observable), "points": point_list(points)}
    solving = Question("solve", "density", ("observables",), "density")  # all methods do
    own: Any = {"tol": asked.tol, "partial": True}
    asked.reply(solving, of, given, work, **own)


@asking(
    click.option("--rates", type=click.IntRange(1, 100), default=5, help="Default 5."),
    TOL,
    MEMORY,
)
def relaxation(asked: Asked, rates: int) -> None:
    """Give the slowest rates at which the system forgets its past.

    They are the real parts of eigenvalues, beside the imaginary parts, angular frequencies; of a
    conjugate pair one is listed.
    """
    asked.reply(
        QUESTIONS["relaxation"],
        "relaxation",
        {},
        lambda method, **how: method.relaxation(asked.scene.system, rates, **how),
    )


def command_of(name: str) -> click.Command | None:
    """Return the command of the question ``name`` if it is about a displacement, else None."""
    question = QUESTIONS.get(name)
    if question is None or not question.of_displacement:
        return None

    def curve(asked: Asked, of: str, at: str) -> None:
        observable, system = parts.observable_of(of, asked.scene), asked.scene.system
        from cases.scene.points import parse_points
        from fpk.system.modulation import require_constant_noise

        if len(observable) != 1 or observable[0].kind != "q":
            raise BadInput(f'--of "{of}": use a displacement, q1..q{system.n}')
        (points,) = parse_points(at, 1)

        def work(method: Any, **how: Any) -> Any:
            require_constant_noise(system.modulation)
            return getattr(method, name)(system, observable, points, **how)

        given = {"observable": str(observable[0]), "points": points}
        asked.reply(question, f"{name} of {of}", given, work)

    curve.__name__, curve.__doc__ = name, question.help
    return asking(*DISPLACEMENT)(curve)


crossings, spectrum, correlation = map(command_of, ("crossings", "spectrum", "correlation"))

START = click.option(
    "--start", metavar="START", default="rest",
    help="rest (the default), H=0.3, H1=0.1,H2=0.2, q1=..,p1=..,.. or noise=0.5.",
)  # fmt: skip


@asking(
    parts.of(required=True, help="H, q1.., p1.., H1.. or a pair a,b."),
    START,
    click.option("--times", metavar="LIST", required=True, help="Times after the start."),
    *(AT, TOL, *SIMULATED),
)
def transient(asked: Asked, of: str, start: str, times: str, at: str) -> None:
    """Give the density of an observable at times after a start."""
    system, observable = asked.scene.system, parts.observable_of(of, asked.scene)
    from cases.scene.points import parse_points
    from cases.show.records import point_list
    from fpk.answer.names import observable_name, parse_start

    begin = parts.read("start", start, lambda: parse_start(start, system))
    points, later = parse_points(at, len(observable)), _times(times)
    name = observable_name(observable)
    asked.reply(
        QUESTIONS["transient"],
        f"the density of {of}",
        {"observable": name, "start": str(begin), "points": point_list(points)},
        lambda method, **how: method.transient(system, observable, begin, later, points, **how),
    )


@asking(
    click.option(
        "--limit",
        metavar="LIMIT",
        required=True,
        help="H=1.5, H1=0.4,H2=0.6, q2=1.2, 'q2>1.2', 'q2<-0.8' or v2=0.9.",
    ),
    START,
    click.option("--times", metavar="LIST", help="Times at which the reliability is given."),
    *(TOL, *SIMULATED),
)
def passage(asked: Asked, limit: str, start: str, times: str | None) -> None:
    """Give the first passage of a limit: moments of its time, failure rate, reliability.

    Where it is so rare that a plain simulation sees too few in all the time that it may take,
    montecarlo gives the reliability at the times by multilevel splitting, and no more.
    """
    from cases.compare.rare import passage_answer
    from cases.scene.questions import PassageQuestion, require_below
    from fpk.answer.names import parse_limit, parse_start

    system = asked.scene.system
    begin = parts.read("start", start, lambda: parse_start(start, system))
    end = parts.read("limit", limit, lambda: parse_limit(limit, system.n))
    parts.read("start", start, lambda: require_below(system, end, begin))
    question = PassageQuestion(end, begin, tuple(_times(times).tolist()))
    asked.reply(
        QUESTIONS["passage"],
        "first passage",
        {"limit": str(end), "start": str(begin)},
        lambda method, **how: passage_answer(method, system, question, **how),
    )


def _times(text: str | None) -> Any:
    """Return the times (times,) in ``text``, an empty array for None.

    Raises ``BadInput`` unless they are >= 0 and strictly ascend.
    """
    import numpy as np

    from cases.scene.points import parse_points
    from fpk.answer.dynamics import require_times

    if text is None:
        return np.zeros(0)
    (times,) = parse_points(text, 1, option="times")
    return parts.read("times", text, lambda: require_times(times))
