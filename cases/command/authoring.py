"""The commands about a scene itself: new, check, show, schema; and completion of the shell."""

import json
import re
from pathlib import Path

import click
from click.shell_completion import get_completion_class

from cases.command import completed, parts
from cases.scene.errors import BadInput

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


@click.command()
@click.argument("name")
@click.option("--masses", type=click.IntRange(1, 500), default=2, help="Default 2.")
@click.option(
    "--law", default="hertz", help="Contact law, such as bilinear; hertz by default.",
    shell_complete=completed.laws,
)  # fmt: skip
@parts.out(help="File to write; NAME.toml if left out.")
@parts.as_json
def new(name: str, masses: int, law: str, out: Path | None) -> None:
    """Write a commented scene to start from, and its JSON Schema beside it for editors.

    A file that is there is never overwritten.
    """
    from cases.scene.json_schema import FILE, scene_schema, scene_text
    from cases.scene.scene import shipped_scenes
    from cases.show.files import write_text
    from fpk.system.contact_law import LAWS

    if not NAME.fullmatch(name):
        raise BadInput(f"NAME {json.dumps(name)}: use up to 64 letters, digits, - and _")
    if name in shipped_scenes():
        raise BadInput(f"NAME {name}: a shipped scene has this name; use another")
    if law not in LAWS:
        raise BadInput(f"--law {json.dumps(law)}: use one of {', '.join(sorted(LAWS))}")
    path = Path(f"{name}.toml") if out is None else out
    if not path.parent.is_dir():
        raise BadInput(f"--out {path}: the folder {path.parent} does not exist")
    require_free(path)
    schema = path.with_name(FILE)
    texts = {path: scene_text(name, masses, law)}
    if not schema.exists():
        texts[schema] = json.dumps(scene_schema(), indent=1) + "\n"
    for file, text in texts.items():
        write_text(file, text)
    record = {"scene": name, "file": str(path), "files": list(map(str, texts))}
    words = f"a scene to start from: fpk check {path} says what applies to it"
    parts.end(record, lambda: words, list(texts))


def facts_command(name: str, words: str) -> click.Command:
    """Return the command ``name``, "check" or "show", about a scene; ``words`` are its help."""

    @click.command(name, help=words)
    @parts.scene_name
    @parts.as_json
    def command(scene: str) -> None:
        loaded = parts.load_checked(scene)
        from cases.show import facts
        from cases.show.bar import progress_bar
        from cases.show.text import render

        with progress_bar() as progress:
            solved = (progress,) if name == "check" else ()  # show makes no solutions
            record = getattr(facts, f"{name}_record")(loaded, *solved)
        parts.end(record, lambda: render(f"{name}.txt", record))

    return command


check = facts_command(
    "check", "Say whether a scene is valid, which theories apply, and about what a run of it costs."
)
show = facts_command(
    "show", "Show the system, its effects, frequencies, and which theories apply and why."
)


@click.command()
@parts.out(help="File to write; printed if left out.")
def schema(out: Path | None) -> None:
    """Give the JSON Schema of a scene, by which an editor completes and checks it.

    Taplo and Even Better TOML read it where the first line of a scene says
    "#:schema ./scene.schema.json".
    """
    from cases.scene.json_schema import scene_schema
    from cases.show.files import write_text

    text = json.dumps(scene_schema(), indent=1)
    if out is None:
        click.echo(text)
        return
    require_free(out)
    write_text(out, text + "\n")
    click.echo(f"wrote {out}")


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print the script that completes commands, options and shipped scenes in a shell."""
    script = get_completion_class(shell)
    assert script is not None  # click has the three
    click.echo(script(context.find_root().command, {}, "fpk", "_FPK_COMPLETE").source())


def require_free(path: Path) -> None:
    """Raise ``BadInput`` if a file, folder or link exists at ``path``: it is not overwritten."""
    if path.exists() or path.is_symlink():
        raise BadInput(f"{path}: is there already, and is not overwritten; give another --out")
