"""What the commands of ``fpk`` share: options, ends, JSON; nothing heavy is imported here."""

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from cases.comparison.run import Outcome
    from cases.scene.scene import Scene
    from cases.studies.tables import Page

SceneName = Annotated[
    str, typer.Argument(metavar="SCENE", help="A shipped scene's name or a path.")
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object, nothing else.")]
Tol = Annotated[float | None, typer.Option(help="L1 error wanted; a solver adapts to meet it.")]
Seed = Annotated[int | None, typer.Option(min=0, max=2**64 - 1, help="Seed of the simulation.")]
Seconds = Annotated[
    float | None, typer.Option(help="Seconds of wall time after which the simulation stops.")
]
StepPair = Annotated[
    bool, typer.Option("--step-pair", help="Simulate at half the step, too: measures its bias.")
]
Step = Annotated[
    float | None, typer.Option("--dt", help="Step of the simulation; chosen if left out.")
]
AllowUnstable = Annotated[
    bool, typer.Option("--allow-unstable", help="Take a --dt beyond the limit, uncertified.")
]
Threads = Annotated[int | None, typer.Option(min=1, help="Threads of the simulation.")]

Cluster = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Simulate on the Dask cluster there: tcp://HOST:PORT."),
]
Checkpoint = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Keep the simulation's state there and go on from it."),
]
StudyFolder = Annotated[
    Path | None,
    typer.Option(
        "--out", help="Folder for the study: tables (.md), numbers (.nc), picture (.svg)."
    ),
]
FIRST_SEED = 1
"""Seed of a study where none is given."""


def begin_study(scene: str, out: Path | None = None) -> "Scene":
    """Load the scene and make the folder of a study, so that a refusal comes before any work.

    Linear algebra takes one thread from here on: small matrices gain nothing from more, and times
    of routes can be compared then and do not depend on load.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from cases.output.files import make_folder
    from cases.scene.scene import load_scene

    loaded = load_scene(scene)
    if out is not None:
        make_folder(out)
    return loaded


def end_study(study: Any, page: "Page", out: Path | None, *, as_json: bool) -> None:
    """Write a study's page to ``out``, print it or the JSON object, and say the problems."""
    written = [] if out is None else page.write(out)
    if as_json:
        print_json(study.record())
    else:
        text = page.summary if written and page.summary else page.text().rstrip()
        typer.echo("\n".join([text, *(f"wrote {path}" for path in written)]))
    end_with(study.problems)


def end_with(problems: Any) -> None:
    """Say every problem on standard error; status 1 where there is one."""
    for problem in problems:
        typer.echo(f"fpk: {problem}", err=True)
    if problems:
        raise typer.Exit(1)


def outcome_of(scene: "Scene", methods: Any) -> "Outcome":
    """Run ``scene`` by ``methods`` under a progress bar."""
    from cases.comparison.run import run_scene
    from cases.output.terminal import progress_bar

    with progress_bar() as progress:
        return run_scene(scene, methods, progress=progress)


def check_cluster(address: str | None) -> None:
    """Refuse a cluster that does not answer before anything else is done."""
    if address is not None:
        from sim.cluster import connected

        with connected(address):
            pass


def check_tol(tol: float | None) -> None:
    """Refuse a tolerance that no solver can mean."""
    from cases.scene.errors import BadInput

    if tol is not None and not 1e-12 <= tol <= 0.1:
        raise BadInput(f"--tol {tol:g}: must be between 1e-12 and 0.1")


def print_json(record: dict[str, Any]) -> None:
    """Print the one JSON object of a command."""
    typer.echo(json.dumps(record, ensure_ascii=False, allow_nan=False))
