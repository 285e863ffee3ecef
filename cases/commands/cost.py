"""The command ``fpk cost``: what each digit costs in time, by every route."""

from pathlib import Path
from typing import Any

import click

from cases.commands.parts import (
    as_json,
    begin_study,
    end_study,
    given,
    progress_bar,
    scene_name,
    seed,
    study_folder,
)


@click.command()
@scene_name
@study_folder
@click.option(
    "--simulate/--no-simulate", default=True, help="With the sampling routes, or without."
)
@seed
@as_json
def cost(scene: str, out: Path | None, as_json: bool, **settings: Any) -> None:
    """Time every route whose answer agrees with the reference, and price each digit."""
    loaded = begin_study(scene, out)
    from cases.studies.cost import study_cost
    from cases.studies.cost_page import cost_page

    with progress_bar() as progress:
        study = study_cost(loaded, progress=progress, **given(settings))
    end_study(study, cost_page(study), out, as_json=as_json)
