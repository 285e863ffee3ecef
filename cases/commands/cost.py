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
    from cases.studies.cost_output import MEANING, cost_tables, write_cost
    from cases.studies.tables import terminal_text

    with progress_bar() as progress:
        study = study_cost(
            loaded,
            simulate=simulate,
            seed=FIRST_SEED if seed is None else seed,
            progress=progress,
        )
    written = [] if out is None else write_cost(study, out)
    title = f"What accuracy costs: {loaded.title}"
    end_study(
        study,
        lambda: f"{terminal_text(title, cost_tables(study))}\n{MEANING}",
        written,
        as_json=as_json,
    )
