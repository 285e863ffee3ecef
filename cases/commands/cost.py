"""The command ``fpk cost``: what each digit costs in time, by every route."""

from typing import Annotated

import typer

from cases.commands.parts import (
    FIRST_SEED,
    Json,
    SceneName,
    Seed,
    StudyFolder,
    begin_study,
    end_study,
)


def cost(
    scene: SceneName,
    out: StudyFolder = None,
    simulate: Annotated[
        bool, typer.Option("--simulate/--no-simulate", help="With the sampling routes, or without.")
    ] = True,
    seed: Seed = None,
    as_json: Json = False,
) -> None:
    """Time every route whose answer agrees with the reference, and price each digit."""
    loaded = begin_study(scene, out)
    from cases.output.terminal import progress_bar
    from cases.studies.cost import study_cost
    from cases.studies.cost_output import cost_page

    seed = FIRST_SEED if seed is None else seed
    with progress_bar() as progress:
        study = study_cost(loaded, simulate=simulate, seed=seed, progress=progress)
    end_study(study, cost_page(study), out, as_json=as_json)
