"""The command ``fpk converge``: how errors fall with the discretisation."""

from typing import Annotated

import typer

from cases.commands.parts import (
    FIRST_SEED,
    Json,
    SceneName,
    Seed,
    StudyFolder,
    Threads,
    begin_study,
    end_study,
)


def converge(
    scene: SceneName,
    route: Annotated[
        str | None, typer.Option(help="nonintegrable, integrable or montecarlo; all if left out.")
    ] = None,
    of: Annotated[
        str | None, typer.Option(metavar="OBS", help="H or H1,H2: the equation of that density.")
    ] = None,
    out: StudyFolder = None,
    seconds: Annotated[
        float | None, typer.Option(min=0.1, help="Processor time for the steps of each scheme.")
    ] = None,
    seed: Seed = None,
    threads: Threads = None,
    as_json: Json = False,
) -> None:
    """Measure orders of convergence: in h, in p, in both, in the step and in samples."""
    loaded = begin_study(scene, out)
    from cases.output.terminal import progress_bar
    from cases.studies.converge import SECONDS, chosen_routes, study_convergence
    from cases.studies.converge_output import convergence_page

    routes = chosen_routes(route, of)
    with progress_bar() as progress:
        study = study_convergence(
            loaded,
            routes,
            seconds=seconds or SECONDS,
            seed=FIRST_SEED if seed is None else seed,
            threads=threads,
            progress=progress,
        )
    end_study(study, convergence_page(study), out, as_json=as_json)
