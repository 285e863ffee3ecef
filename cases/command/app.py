"""The commands of ``fpk``: a thin edge; heavy parts are imported inside the commands only."""

import atexit
import gc
import os
import sys
import warnings
from functools import partial
from importlib import import_module
from pathlib import Path
from shutil import get_terminal_size
from time import perf_counter
from typing import Any

import click

from cases.command import authoring, dynamics, parts, studies
from cases.command.examples import EXAMPLES
from cases.scene.errors import BadInput, misspelt, one_line
from cases.study import STUDIES
from fpk.answer.question import QUESTIONS
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified, Unavailable

WIDEST = 10_000
"""Largest width of a help text in columns: no terminal is wider."""


class Commands(click.Group):
    """All commands, including commands of questions and studies that are registered later."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return the command ``cmd_name``, None if there is none; ``ctx`` is click's context."""
        command = super().get_command(ctx, cmd_name) or dynamics.command_of(cmd_name)
        return command or studies.command_of(cmd_name)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands in alphabetical order."""
        own = [name for name in QUESTIONS if dynamics.command_of(name)]
        return sorted({*super().list_commands(ctx), *own, *STUDIES})


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": WIDEST},
)
@click.version_option(package_name="vibro-fpk", prog_name="fpk", message="%(prog)s %(version)s")
def app() -> None:
    """Stationary densities of randomly excited vibro-impact systems.

    By closed form, finite elements and simulation, compared. Exit status: 0 all checks hold, 1 one
    does not, 2 bad input.
    """


@app.command("list")
@parts.as_json
def list_scenes() -> None:
    """List the shipped scenes."""
    from cases.scene.scene import load_scene, shipped_scenes

    rows = []
    for name, path in shipped_scenes().items():
        scene = load_scene(name)
        row = {"name": name, "folder": path.parent.name}
        rows.append({**row, "title": scene.title, "source": scene.source})
    width = max(len(row["name"]) for row in rows)
    lines = [f"{row['name']:{width}}  {row['folder']:5}  {row['title']}" for row in rows]
    parts.end({"scenes": rows}, lambda: "\n".join(lines))


@app.command()
@parts.scene_name
@parts.out(help="Folder for report, netCDF, pictures.")
@parts.simulation_options
@parts.of(multiple=True, help="Only this; may be given several times.")
@parts.method(
    "only",
    multiple=True,
    metavar="METHOD",
    help="Only this method, or method/solver; may be given several times.",
)
@click.option("--simulation/--no-simulation", default=True, help="With the simulations, or not.")
@click.option("--details", is_flag=True, help="Every comparison, every route and why not.")
@click.option("--quiet", is_flag=True, help="Print problems only.")
@parts.as_json
def run(
    scene: str, out: Path | None, of: tuple[str, ...], only: tuple[str, ...], simulation: bool,
    details: bool, quiet: bool, **settings: Any,
) -> None:  # fmt: skip
    """Run every applicable route of a scene, compare them, and write a report.

    Prints the quantities (mean, rms, quantiles, what stops feel) by route, then the verdicts.
    """
    start, loaded = perf_counter(), parts.load_checked(scene, tol=settings["tol"], out=out)
    loaded = parts.only_observables(loaded, of, whole=simulation and not only)
    from cases.compare.routes import all_methods, chosen_methods
    from cases.show.digest import digest_of
    from cases.show.text import render

    parts.check_cluster(settings["cluster"])
    parts.checkpoint_folder(loaded, {**settings, "tol": None})  # no simulation depends on it
    from cases.show.bar import progress_bar
    from cases.show.fields import write_netcdf

    def save(outcome: Any) -> None:
        if outcome.curves[-1].interrupted:
            if not any(curve.answered for curve in outcome.curves):
                raise KeyboardInterrupt
            click.echo("fpk: stopped; what there is follows, Ctrl-C again ends at once", err=True)
        if out is not None:
            write_netcdf(outcome, out / parts.FIELDS)

    methods, asked = all_methods(named=only, **settings, partial=True), settings["tol"]
    methods = chosen_methods(methods, only, simulation=simulation)
    outcome = parts.outcome_of(
        loaded, methods, partial=True, relax=asked is None, tol=asked, save=save
    )
    if only and not any(curve.answered for curve in outcome.curves):
        raise BadInput(f"{loaded.name}: {'; '.join(outcome.curves[0].problems)}")
    written, digest = [], digest_of(outcome)
    if asked is not None and any(method.route.sampled for method in methods):
        digest["notes"].append(f"--tol {asked:g} is for the solvers; simulations take --seconds")
    if out is not None:
        from cases.show.report import write_report
        from cases.show.vtk import write_time_pvd

        with progress_bar() as progress:
            report, *pictures = write_report(
                outcome, digest, out, command=parts.command_line(), progress=progress
            )
        written = [report, out / parts.FIELDS, *pictures, *write_time_pvd(outcome, out)]
    digest["seconds"] = perf_counter() - start
    shown = {
        "digest": digest,
        "details": details,
        "width": get_terminal_size((100, 24)).columns - 2,
    }
    text = partial(render, "run.txt", shown)
    parts.end(digest, text, written, problems=outcome.problems, quiet=quiet)


for _module in (authoring, dynamics, studies):
    for _command in vars(_module).values():
        if isinstance(_command, click.Command):
            app.add_command(_command)
for _name, _lines in EXAMPLES.items():
    app.commands[_name].epilog = "\b\nExamples:\n" + "\n".join(f"  {line}" for line in _lines)


def run_app() -> None:
    """Run the command line, then exit; a user's mistake ends in one line with the status 2.

    ``NotCertified`` and a closed pipe end with the status 1. Ctrl-C raises ``KeyboardInterrupt``.
    """
    # What the libraries allocate stays: to look for garbage in it again and again while they are
    # imported, and once more at the end, takes a fifth of the time of a short command.
    gc.set_threshold(100_000, 50, 50)
    atexit.register(gc.freeze)
    warnings.formatwarning = lambda message, *_: f"fpk: warning: {one_line(str(message))}\n"
    try:
        import_extensions()
        # Outside standalone mode click hands usage errors over instead of printing four lines.
        sys.exit(app.main(prog_name="fpk", standalone_mode=False) or 0)
    except click.Abort as error:
        # click means by it Ctrl-C or EOFError; without prompts the latter is no wish of the user.
        raise error.__cause__ or KeyboardInterrupt from None
    except BrokenPipeError:
        sys.stderr.close()  # the reader has gone: say nothing more
        sys.exit(1)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        sys.exit(2)
    except click.ClickException as error:
        context = error.ctx if isinstance(error, click.UsageError) else None
        command = context.command_path if context else "fpk"
        if similar := getattr(error, "possibilities", None):  # by click: of many common letters
            word = getattr(error, "option_name", None) or getattr(error, "command_name", None)
            near = [name for name in similar if misspelt(str(word), [name])]
            vars(error)["possibilities"] = near
        _fail(f"{error.format_message()} ({command} --help says more)", 2)
    except NotCertified as error:
        _fail(str(error), 1)
    except (BadInput, InvalidInput, NotApplicable, Unavailable) as error:
        _fail(str(error), 2)


def import_extensions() -> None:
    """Import the modules named in the environment variable ``FPK_IMPORT``, parted by commas.

    They register laws, methods, questions, studies or formats of the user's own. Raises
    ``BadInput`` with the error of a module that cannot be imported.
    """
    for name in filter(None, os.environ.get("FPK_IMPORT", "").split(",")):
        try:
            import_module(name)
        except Exception as error:
            kind = type(error).__name__
            raise BadInput(f"FPK_IMPORT: {name} is not imported: {kind}: {error}") from error


def _fail(message: str, status: int) -> None:
    click.echo(f"fpk: {one_line(' '.join(message.split()))}", err=True)
    sys.exit(status)
