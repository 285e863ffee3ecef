"""The command ``fpk converge``: how errors fall with the discretisation."""

import os
from pathlib import Path
from typing import Annotated

import typer

from cases.command_parts import Json, SceneName, Seed, Threads, end_with, print_json


def converge(
    scene: SceneName,
    route: Annotated[
        str | None, typer.Option(help="nonintegrable, integrable or montecarlo; all if left out.")
    ] = None,
    of: Annotated[
        str | None, typer.Option(metavar="OBS", help="H or H1,H2: the equation of that density.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for converge.md, converge.nc, converge.svg.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(min=0.1, help="Processor time for the steps of each scheme.")
    ] = None,
    seed: Seed = None,
    threads: Threads = None,
    as_json: Json = False,
) -> None:
    """Measure orders of convergence: in h, in p, in both, in the step and in samples."""
    # One thread of linear algebra: small matrices gain nothing from more, and wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from cases.files import make_folder
    from cases.scene import load_scene

    loaded = load_scene(scene)
    if out is not None:
        make_folder(out)
    from cases.study.converge import SECONDS, chosen_routes, study_convergence
    from cases.terminal import progress_bar

    routes = chosen_routes(route, of)
    with progress_bar() as progress:
        found = study_convergence(
            loaded,
            routes,
            seconds=seconds or SECONDS,
            seed=1 if seed is None else seed,
            threads=threads,
            progress=progress,
        )
    if as_json:
        written = []
        print_json(found.record())
    if out is not None:
        from cases.study.converge_output import write_study

        written = write_study(found, out)
    if not as_json:
        from cases.study.converge_output import study_tables
        from cases.study.tables import terminal_text

        typer.echo(terminal_text(f"Convergence: {loaded.title}", study_tables(found)))
        for path in written if out is not None else []:
            typer.echo(f"wrote {path}")
    end_with(found.problems)
