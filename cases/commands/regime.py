"""The command ``fpk regime``: which theory holds where, over a grid of parameters."""

from pathlib import Path
from typing import Any

import click

from cases.commands.parts import (
    FOLDER,
    as_json,
    begin_study,
    check_cluster,
    cluster,
    end_study,
    given,
    progress_bar,
    scene_name,
    seed,
    threads,
)


@click.command()
@scene_name
@click.option(
    "--vary",
    multiple=True,
    required=True,
    metavar="KEY=LOW:HIGH:COUNT",
    help="Once or twice; logCOUNT: equal ratios.",
)
@click.option("--out", type=FOLDER, help="Folder for picture, table, netCDF; a map goes on there.")
@seed
@threads
@click.option("--paths", type=int, help="Paths of the simulation.")
@click.option("--time", type=float, help="Sampled time a path.")
@cluster
@click.option("--checkpoint", type=FOLDER, help="Folder for finished points, if not --out.")
@as_json
def regime(
    scene: str,
    vary: tuple[str, ...],
    out: Path | None,
    checkpoint: Path | None,
    as_json: bool,
    **settings: Any,
) -> None:
    """Map the distance of each theory to the full system over one or two parameters."""
    loaded = begin_study(scene)
    from cases.output.files import make_folder
    from cases.studies.regime_map.grid import parse_axes

    axes = parse_axes(vary, loaded.system)
    for folder in (out, checkpoint):
        if folder is not None:
            make_folder(folder)
    check_cluster(settings["cluster"])
    from cases.studies.regime_map.map import MAP_RELAXATIONS, build_map
    from cases.studies.regime_map.map_page import map_page
    from sim.montecarlo import MonteCarlo

    simulation = MonteCarlo(**{"relaxations": MAP_RELAXATIONS, **given(settings)})
    with progress_bar() as progress:
        store = checkpoint or out
        result = build_map(loaded, axes, simulation=simulation, folder=store, progress=progress)
    if result.note is not None:
        click.echo(f"fpk: note: {result.note}", err=True)
    end_study(result, map_page(result), out, as_json=as_json)
