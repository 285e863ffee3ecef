"""The command ``fpk verify``: the regression gate."""

from typing import Any

import click

from cases.commands.parts import as_json, end, seed, threads


@click.command()
@click.argument("scenes", nargs=-1, metavar="[SCENE]...")
@click.option("--coarse", is_flag=True, help="A quick look: a still shorter simulation.")
@seed
@threads
@as_json
def verify(scenes: tuple[str, ...], as_json: bool, **settings: Any) -> None:
    """Run scenes by every route and judge them: one line each, one final table.

    SCENE: names or paths; all shipped scenes but the hard ones where none is given.
    """
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
            verified.append(verify_scene(scene, progress=progress, **settings))
        if not as_json:
            click.echo(verify_line(verified[-1], width))
    end(
        verify_record(verified) if as_json else None,
        lambda: verify_table(verified),
        problems=[f"{v.scene}: {problem}" for v in verified for problem in v.problems],
    )
