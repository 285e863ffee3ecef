"""The command ``fpk regime``: which theory holds where, over a grid of parameters."""

from pathlib import Path
from typing import Annotated, Any

import typer

from cases.commands.parts import (
    Cluster,
    Json,
    SceneName,
    Seed,
    Threads,
    begin_study,
    check_cluster,
    end_study,
)


def regime(
    scene: SceneName,
    vary: Annotated[
        list[str],
        typer.Option(metavar="KEY=LOW:HIGH:COUNT", help="Once or twice; logCOUNT: equal ratios."),
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder for picture, table, netCDF; a map goes on there.")
    ] = None,
    seed: Seed = None,
    threads: Threads = None,
    paths: Annotated[int | None, typer.Option(help="Paths of the simulation.")] = None,
    time: Annotated[float | None, typer.Option(help="Sampled time a path.")] = None,
    cluster: Cluster = None,
    checkpoint: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for finished points, if not --out.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Map the distance of each theory to the full system over one or two parameters."""
    loaded = begin_study(scene)
    from cases.output.files import make_folder
    from cases.output.terminal import progress_bar
    from cases.studies.regime_map.grid import parse_axes

    axes = parse_axes(vary, loaded.system)
    for folder in (out, checkpoint):
        if folder is not None:
            make_folder(folder)
    check_cluster(cluster)
    from cases.studies.regime_map.build import MAP_RELAXATIONS, build_map
    from cases.studies.regime_map.output import map_page
    from sim.montecarlo import MonteCarlo

    settings = {"seed": seed, "threads": threads, "paths": paths, "time": time, "cluster": cluster}
    given: dict[str, Any] = {k: v for k, v in settings.items() if v is not None}
    simulation = MonteCarlo(**{"relaxations": MAP_RELAXATIONS, **given})
    with progress_bar() as progress:
        result = build_map(
            loaded, axes, simulation=simulation, folder=checkpoint or out, progress=progress
        )
    if result.note is not None:
        typer.echo(f"fpk: note: {result.note}", err=True)
    end_study(result, map_page(result), out, as_json=as_json)
