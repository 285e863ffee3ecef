"""The command ``fpk cost``: what each digit costs in time, by every route."""

import os
from pathlib import Path
from typing import Annotated

import typer

from cases.command_parts import Json, SceneName, Seed, end_with, print_json


def cost(
    scene: SceneName,
    out: Annotated[Path | None, typer.Option(help="Folder for cost.md, cost.nc, cost.svg.")] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate/--no-simulate", help="With the sampling routes, or without.")
    ] = True,
    seed: Seed = None,
    as_json: Json = False,
) -> None:
    """Time every route whose answer agrees with the reference, and price each digit."""
    # One thread of linear algebra: times of routes can be compared then, and do not depend on load.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from cases.files import make_folder
    from cases.scene import load_scene

    loaded = load_scene(scene)
    if out is not None:
        make_folder(out)
    from cases.study.cost import study_cost
    from cases.study.cost_output import MEANING, cost_tables, write_cost
    from cases.study.tables import terminal_text
    from cases.terminal import progress_bar

    with progress_bar() as progress:
        found = study_cost(
            loaded, simulate=simulate, seed=1 if seed is None else seed, progress=progress
        )
    written = [] if out is None else write_cost(found, out)
    if as_json:
        print_json(found.record())
    else:
        typer.echo(terminal_text(f"What accuracy costs: {loaded.title}", cost_tables(found)))
        typer.echo(MEANING)
        for path in written:
            typer.echo(f"wrote {path}")
    end_with(found.problems)
