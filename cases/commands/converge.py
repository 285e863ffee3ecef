"""The command ``fpk converge``: how errors fall with the discretisation."""

from pathlib import Path
from typing import Any

import click

from cases.commands.parts import (
    as_json,
    begin_study,
    end_study,
    given,
    observable_option,
    progress_bar,
    scene_name,
    seed,
    study_folder,
    threads,
)


@click.command()
@scene_name
@click.option("--route", help="nonintegrable, integrable or montecarlo; all if left out.")
@observable_option("H or H1,H2: the equation of that density.")
@study_folder
@click.option(
    "--seconds", type=click.FloatRange(0.1), help="Processor time for the steps of each scheme."
)
@seed
@threads
@as_json
def converge(
    scene: str, route: str | None, of: str | None, out: Path | None, as_json: bool, **settings: Any
) -> None:
    """Measure orders of convergence: in h, in p, in both, in the step and in samples."""
    loaded = begin_study(scene, out)
    from cases.studies.converge import chosen_routes, study_convergence
    from cases.studies.converge_page import convergence_page

    routes = chosen_routes(route, of)
    with progress_bar() as progress:
        study = study_convergence(loaded, routes, progress=progress, **given(settings))
    end_study(study, convergence_page(study), out, as_json=as_json)
