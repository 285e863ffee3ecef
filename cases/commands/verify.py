"""The command ``fpk verify``: the regression gate."""

from typing import Any

import click

from cases.commands.parts import as_json, end, outcome_of, seed, threads

USUAL, COARSE, COARSE_PATHS = 38.0, 5.0, 4096
"""Relaxation times sampled on a path: a quarter of what ``fpk run`` takes. Bands are from the
sample itself, so that a shorter simulation judges less sharply, never wrongly."""
WORK = 5e10
"""Multiplications that a solution of the full equation may need: a second, and an error below what
sampling leaves."""


@click.command()
@click.argument("scenes", nargs=-1, metavar="[SCENE]...")
@click.option("--coarse", is_flag=True, help="A quick look: a still shorter simulation.")
@seed
@threads
@as_json
def verify(scenes: tuple[str, ...], coarse: bool, **settings: Any) -> None:
    """Run scenes by every route and judge them: one line each, one final table.

    SCENE: names or paths; all shipped scenes but the hard ones where none is given.
    """
    from cases.scene.scene import load_scene, shipped_scenes

    shipped = [name for name, path in shipped_scenes().items() if path.parent.name != "hard"]
    loaded = [load_scene(name) for name in dict.fromkeys(scenes or shipped)]
    from cases.comparison.routes import all_methods
    from cases.output.digest import digest_of, verify_record, verify_row
    from cases.output.text import rendered

    if coarse:
        settings |= {"paths": COARSE_PATHS}
    methods = all_methods(relaxations=COARSE if coarse else USUAL, work=WORK, **settings)
    width = max(len(scene.name) for scene in loaded)
    rows = []
    for scene in loaded:
        rows.append(verify_row(digest_of(outcome_of(scene, methods))))
        if not click.get_current_context().meta["json"]:
            click.echo(rendered("verify_line.txt", {"row": rows[-1], "width": width}))
    end(
        verify_record(rows),
        lambda: rendered("verify.txt", {"rows": rows}),
        problems=[f"{row['scene']}: {problem}" for row in rows for problem in row["problems"]],
    )
