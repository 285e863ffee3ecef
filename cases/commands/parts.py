"""Options, exit statuses and JSON output shared by the commands of ``fpk``; light to import."""

import json
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from cases.comparison.run import Outcome
    from cases.scene.scene import Scene
    from cases.studies.page import Page
    from fpk.method import Progress
    from fpk.observable import Observable

Decorator = Callable[[Any], Any]

FOLDER = click.Path(path_type=Path)

scene_name = click.argument("scene", metavar="SCENE")
as_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON object alone.")
tol = click.option("--tol", type=float, help="L1 error wanted; a solver adapts to meet it.")
seed = click.option("--seed", type=click.IntRange(0, 2**64 - 1), help="Seed of the simulation.")
threads = click.option("--threads", type=click.IntRange(1), help="Threads of the simulation.")
cluster = click.option(
    "--cluster", metavar="ADDRESS", help="Simulate on the Dask cluster there: tcp://HOST:PORT."
)
study_folder = click.option(
    "--out", type=FOLDER, help="Folder for the study: tables (.md), numbers (.nc), picture (.svg)."
)


def observable_option(help: str, *, required: bool = False) -> Decorator:
    """Return the option ``--of``."""
    return click.option("--of", metavar="OBS", required=required, help=help)


def simulation_options(command: Any) -> Any:
    """Add the options of the routes: ``tol`` and all that a simulation takes, by these names."""
    options = (
        tol,
        seed,
        threads,
        click.option("--seconds", type=float, help="Wall time after which the simulation stops."),
        click.option("--step-pair", is_flag=True, help="Simulate at half the step, too."),
        click.option("--dt", type=float, help="Step of the simulation; chosen if left out."),
        click.option("--allow-unstable", is_flag=True, help="Take a --dt beyond the limit."),
        cluster,
        click.option(
            "--checkpoint", type=FOLDER, help="Keep the simulation's state there, go on from it."
        ),
    )
    for option in reversed(options):
        command = option(command)
    return command


def checked(scene: str, *, tol: float | None = None, out: Path | None = None) -> "Scene":
    """Load the scene, check the tolerance, make the folder: a refusal comes before any work."""
    from cases.scene.errors import BadInput
    from cases.scene.scene import load_scene

    loaded = load_scene(scene)
    if tol is not None and not 1e-12 <= tol <= 0.1:
        raise BadInput(f"--tol {tol:g}: must be between 1e-12 and 0.1")
    if out is not None:
        from cases.output.files import make_folder

        make_folder(out)
    return loaded


def observable_of(name: str, scene: "Scene") -> "Observable":
    """Return what ``--of`` names; raise ``BadInput`` where it is no observable of the scene."""
    from cases.scene.errors import BadInput
    from fpk.errors import InvalidInput
    from fpk.observable import parse_observable

    try:
        return parse_observable(name, scene.system.n)
    except InvalidInput as error:
        raise BadInput(f'--of "{name}": {error.remedy}') from None


def given(settings: dict[str, Any]) -> dict[str, Any]:
    """Return the options that were given; for the others the defaults of the work itself hold."""
    return {key: value for key, value in settings.items() if value is not None}


def begin_study(scene: str, out: Path | None = None) -> "Scene":
    """Load the scene and make the folder of a study.

    Linear algebra takes one thread from here on: small matrices gain nothing from more, and times
    of routes can be compared then and do not depend on load.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return checked(scene, out=out)


def end_study(study: Any, page: "Page", out: Path | None, *, as_json: bool) -> None:
    """Write a study's page to ``out``, print it or the JSON object, and say the problems."""
    from cases.output.records import plain

    written = [] if out is None else page.write(out)
    short = page.summary if written and page.summary else None
    record = plain(study.record()) if as_json else None
    end(record, lambda: short or page.text().rstrip(), written, problems=study.problems)


def end(
    record: dict[str, Any] | None,
    text: Callable[[], str],
    written: Sequence[Path] = (),
    *,
    problems: Sequence[str] = (),
) -> None:
    """Print the one JSON object of a command, or ``text()`` and the files written where it is None.

    Every problem goes to standard error; with one the status is 1.
    """
    if record is not None:
        click.echo(json.dumps(record, ensure_ascii=False, allow_nan=False))
    else:
        click.echo("\n".join([text(), *(f"wrote {path}" for path in written)]))
    for problem in problems:
        click.echo(f"fpk: {problem}", err=True)
    if problems:
        raise click.exceptions.Exit(1)


def progress_bar() -> "AbstractContextManager[Progress]":
    """Return a context with a progress callback, which draws where standard error is a terminal."""
    if not sys.stderr.isatty():
        from fpk.method import silent

        return nullcontext(silent)
    from cases.output.bar import drawn_progress

    return drawn_progress()


def outcome_of(scene: "Scene", methods: Any) -> "Outcome":
    """Run ``scene`` by ``methods`` under a progress bar."""
    from cases.comparison.run import run_scene

    with progress_bar() as progress:
        return run_scene(scene, methods, progress=progress)


def check_cluster(address: str | None) -> None:
    """Refuse a cluster that does not answer before anything else is done."""
    if address is not None:
        from sim.cluster import connected

        with connected(address):
            pass
