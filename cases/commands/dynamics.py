"""The commands about the stationary state: its density and its motion."""

from typing import Any

import click

from cases.commands import parts
from cases.commands.asking import AT, LIST, MEMORY, SIMULATED, TOL, Asked, asking, observed
from cases.scene.errors import BadInput

DISPLACEMENT = (
    observed("A displacement: q1, q2, ..."),
    click.option("--at", metavar="LIST", required=True, help=f"{LIST}."),
    TOL,
    *SIMULATED,
    MEMORY,
)


@asking(
    observed("q1.., p1.., H, H1.. or a pair a,b."),
    AT,
    parts.simulation_options,
    MEMORY,
)
def density(asked: Asked, of: str, at: str) -> None:
    """Give one density at the points asked for."""
    observable = parts.observable_of(of, asked.scene)
    from cases.output.records import columns_text, listed
    from cases.scene.points import parse_points
    from fpk.dynamics import Curve
    from fpk.method import Method, solved
    from fpk.observable import observable_name

    points, settings = parse_points(at, len(observable)), asked.settings
    parts.check_cluster(settings["cluster"])

    def work(method: Method, tol: float | None, progress: Any) -> Curve:
        plan = method.planned(asked.scene.system, [observable])
        parts.checkpoint_folder(asked.scene, {**settings, "tol": tol, "observable": of})
        result = solved(plan, asked.scene.system, [observable], progress=progress)
        (p,) = result.densities
        return Curve(*p.at(*points), p.certificate, result.settings, p.error_kind)

    given = {"observable": observable_name(observable), "points": listed(points)}
    own: Any = {"tol": asked.tol, "partial": True}
    asked.reply(Method, "density", of, given, work, columns_text, key="density", **own)


@asking(*DISPLACEMENT)
def crossings(asked: Asked, of: str, at: str) -> None:
    """Give the upcrossings of levels per unit time in the stationary state.

    By linear, exact, phase-space or the averaged theories (nonintegrable, integrable), or counted
    in a simulation by montecarlo.
    """
    from fpk.dynamics import CrossingsMethod

    _curve(asked, CrossingsMethod, "crossings", "rate", of, at)


@asking(*DISPLACEMENT)
def spectrum(asked: Asked, of: str, at: str) -> None:
    """Give the power spectral density at angular frequencies.

    It is two-sided: its integral over all frequencies, negative ones too, is the variance. By
    linear or phase-space, or estimated from a simulation by montecarlo.
    """
    from fpk.dynamics import StationaryMotionMethod

    _curve(asked, StationaryMotionMethod, "spectrum", "spectrum", of, at)


@asking(*DISPLACEMENT)
def correlation(asked: Asked, of: str, at: str) -> None:
    """Give the autocovariance E q(0) q(t) − (E q)² at lags t >= 0.

    It begins with the variance. By linear or phase-space, or estimated from a simulation by
    montecarlo.
    """
    from fpk.dynamics import StationaryMotionMethod

    _curve(asked, StationaryMotionMethod, "correlation", "correlation", of, at)


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
    from cases.output.records import rates_text
    from fpk.dynamics import Relaxation

    asked.reply(
        Relaxation,
        "relaxation rates",
        "relaxation",
        {},
        lambda method, **how: method.relaxation(asked.scene.system, rates, **how),
        rates_text,
    )


def _curve(asked: Asked, kind: type, question: str, key: str, of: str, at: str) -> None:
    """Ask for the ``question``, a method of the protocol ``kind``, about one displacement."""
    observable, system = parts.observable_of(of, asked.scene), asked.scene.system
    from cases.output.records import columns_text
    from cases.scene.points import parse_points
    from fpk.modulation import require_constant_noise

    if len(observable) != 1 or observable[0].kind != "q":
        raise BadInput(f'--of "{of}": use a displacement, q1..q{system.n}')
    (points,) = parse_points(at, 1)

    def work(method: Any, **how: Any) -> Any:
        require_constant_noise(system.modulation)
        return getattr(method, question)(system, observable, points, **how)

    asked.reply(
        kind,
        question,
        f"{question} of {of}",
        {"observable": str(observable[0]), "points": points},
        work,
        columns_text,
        key=key,
    )
