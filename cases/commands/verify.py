"""The command ``fpk verify``: the regression gate."""

from typing import Annotated

import typer

from cases.commands.parts import Json, Seed, Threads, end_with, print_json


def verify(
    scenes: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENE]...", help="Names or paths; all shipped ones but the hard if left out."
        ),
    ] = None,
    coarse: Annotated[
        bool, typer.Option("--coarse", help="A quick look: a still shorter simulation.")
    ] = False,
    seed: Seed = None,
    threads: Threads = None,
    as_json: Json = False,
) -> None:
    """Run scenes by every route and judge them: one line each, one final table."""
    from cases.scene.scene import load_scene, shipped_scenes

    shipped = [name for name, path in shipped_scenes().items() if path.parent.name != "hard"]
    loaded = [load_scene(name) for name in dict.fromkeys(scenes or shipped)]
    from cases.comparison.verify import verify_scene
    from cases.output.records import verify_record
    from cases.output.terminal import progress_bar
    from cases.output.text import verify_line, verify_table

    width = max(len(scene.name) for scene in loaded)
    verified = []
    for scene in loaded:
        with progress_bar() as progress:
            verified.append(
                verify_scene(scene, coarse=coarse, seed=seed, threads=threads, progress=progress)
            )
        if not as_json:
            typer.echo(verify_line(verified[-1], width))
    if as_json:
        print_json(verify_record(verified))
    else:
        typer.echo(verify_table(verified))
    end_with([f"{v.scene}: {problem}" for v in verified for problem in v.problems])
