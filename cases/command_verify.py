"""The command ``fpk verify``: the regression gate."""

from pathlib import Path
from typing import Annotated

import typer

from cases.command_parts import Json, Seed, Threads, end_with, print_json


def verify(
    scenes: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENE]...", help="Names or paths; all shipped ones but the hard if left out."
        ),
    ] = None,
    hard: Annotated[
        bool, typer.Option("--hard", help="The hard cases instead: stability, not accuracy.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="With --hard: the file for its table, Markdown.")
    ] = None,
    coarse: Annotated[
        bool, typer.Option("--coarse", help="A quick look: a still shorter simulation.")
    ] = False,
    seed: Seed = None,
    threads: Threads = None,
    as_json: Json = False,
) -> None:
    """Run scenes by every route and judge them: one line each, one final table."""
    if hard:
        return _hard(scenes, out, as_json=as_json)
    from cases.scene import load_scene, shipped_scenes

    shipped = [name for name, path in shipped_scenes().items() if path.parent.name != "hard"]
    loaded = [load_scene(name) for name in dict.fromkeys(scenes or shipped)]
    from cases.terminal import progress_bar
    from cases.verify import verify_line, verify_record, verify_scene, verify_table

    width = max(len(scene.name) for scene in loaded)
    found = []
    for scene in loaded:
        with progress_bar() as progress:
            found.append(
                verify_scene(scene, coarse=coarse, seed=seed, threads=threads, progress=progress)
            )
        if not as_json:
            typer.echo(verify_line(found[-1], width))
    if as_json:
        print_json(verify_record(found))
    else:
        typer.echo(verify_table(found))
    end_with([f"{v.scene}: {problem}" for v in found for problem in v.problems])


def _hard(scenes: list[str] | None, out: Path | None, *, as_json: bool) -> None:
    from cases.errors import BadInput

    if scenes:
        raise BadInput("--hard: runs the hard cases of its own; leave the scenes out")
    from cases.files import write_text
    from cases.stability.run import hard_cases, hard_line, hard_record, hard_table
    from cases.terminal import progress_bar

    found = []
    with progress_bar() as progress:
        for case in hard_cases(progress):
            found.append(case)
            if not as_json:
                typer.echo(hard_line(case))
    if out is not None:
        write_text(out, hard_table(found))
    if as_json:
        print_json(hard_record(found))
    end_with([f"{c.name}: {failure}" for c in found for failure in c.failures])
