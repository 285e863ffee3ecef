"""The command ``fpk``: a thin edge; heavy parts are imported inside the commands only."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from cases.commands.converge import converge
from cases.commands.cost import cost
from cases.commands.export import export
from cases.commands.parts import (
    AllowUnstable,
    Checkpoint,
    Cluster,
    Json,
    SceneName,
    Seconds,
    Seed,
    Step,
    StepPair,
    Threads,
    Tol,
    check_cluster,
    check_tol,
    end_with,
    outcome_of,
    print_json,
)
from cases.commands.regime import regime
from cases.commands.verify import verify

app = typer.Typer(
    name="fpk",
    help="Stationary densities of randomly excited vibro-impact systems: closed form, finite"
    " elements and simulation, compared. Exit status: 0 all checks hold, 1 one does not, 2 bad"
    " input.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command("list")
def list_scenes(as_json: Json = False) -> None:
    """List the shipped scenes."""
    from cases.scene.scene import load_scene, shipped_scenes

    scenes = [(path.parent.name, load_scene(name)) for name, path in shipped_scenes().items()]
    if as_json:
        keys = ("name", "folder", "title", "source")
        print_json(
            {
                "scenes": [
                    dict(zip(keys, (s.name, f, s.title, s.source), strict=True)) for f, s in scenes
                ]
            }
        )
        return
    width = max(len(s.name) for _, s in scenes)
    for folder, s in scenes:
        typer.echo(f"{s.name:{width}}  {folder:5}  {s.title}")


@app.command()
def show(scene: SceneName, as_json: Json = False) -> None:
    """Show the system, its effects, frequencies, and which theories apply and why."""
    from cases.scene.scene import load_scene

    loaded = load_scene(scene)  # before the heavy imports: a refusal answers at once
    from cases.output.show import show_record, show_text

    record = show_record(loaded)
    if as_json:
        print_json(record)
    else:
        typer.echo(show_text(record))


@app.command()
def run(
    scene: SceneName,
    tol: Tol = None,
    out: Annotated[Path | None, typer.Option(help="Folder for report, netCDF, pictures.")] = None,
    seed: Seed = None,
    threads: Threads = None,
    seconds: Seconds = None,
    step_pair: StepPair = False,
    dt: Step = None,
    allow_unstable: AllowUnstable = False,
    cluster: Cluster = None,
    checkpoint: Checkpoint = None,
    as_json: Json = False,
) -> None:
    """Run every applicable route of a scene, compare them, and write a report."""
    from cases.output.files import make_folder
    from cases.scene.scene import load_scene

    loaded = load_scene(scene)
    check_tol(tol)
    if out is not None:
        make_folder(out)
    from cases.commands.checkpoints import checkpoint_folder
    from cases.comparison.routes import all_methods
    from cases.output.digest import digest_of
    from cases.output.text import run_text

    check_cluster(cluster)
    folder = checkpoint_folder(checkpoint, loaded, {"seed": seed, "dt": dt, "step_pair": step_pair})
    methods = all_methods(
        tol=tol, seed=seed, threads=threads, seconds=seconds, step_pair=step_pair, cluster=cluster,
        checkpoint=folder, partial=True, dt=dt, allow_unstable=allow_unstable,
    )  # fmt: skip
    outcome = outcome_of(loaded, methods)
    written = []
    if out is not None:
        from cases.output.report import write_report

        written = write_report(outcome, out)
    digest = digest_of(outcome)
    if as_json:
        print_json(digest)
    else:
        typer.echo(run_text(digest))
        for path in written:
            typer.echo(f"wrote {path}")
    end_with(outcome.problems)


@app.command()
def density(
    scene: SceneName,
    method: Annotated[
        str, typer.Option(help="exact, linear, nonintegrable, integrable or montecarlo.")
    ],
    of: Annotated[str, typer.Option(metavar="OBS", help="q1.., p1.., H, H1.. or a pair a,b.")],
    at: Annotated[
        str, typer.Option(metavar="LIST", help='"-1.5:1.5:0.1", "-1,0,0.3", a pair "A x B".')
    ],
    solver: Annotated[
        str | None,
        typer.Option(help="closed-form, quadrature, fem or simulation."),
    ] = None,
    tol: Tol = None,
    seed: Seed = None,
    threads: Threads = None,
    seconds: Seconds = None,
    step_pair: StepPair = False,
    dt: Step = None,
    allow_unstable: AllowUnstable = False,
    cluster: Cluster = None,
    checkpoint: Checkpoint = None,
    as_json: Json = False,
) -> None:
    """Give one density at the points asked for."""
    from cases.scene.errors import BadInput
    from cases.scene.points import parse_points
    from cases.scene.scene import load_scene
    from fpk.errors import InvalidInput, NotApplicable
    from fpk.observable import parse_observable

    loaded = load_scene(scene)
    check_tol(tol)
    try:
        observable = parse_observable(of, loaded.system.n)
    except InvalidInput as error:
        raise BadInput(f'--of "{of}": {error.remedy}') from None
    points = parse_points(at, len(observable))
    from cases.commands.checkpoints import checkpoint_folder
    from cases.comparison.routes import chosen
    from cases.output.records import density_record
    from cases.output.terminal import progress_bar
    from cases.output.text import density_text
    from fpk.method import solved

    check_cluster(cluster)
    try:
        plan = chosen(
            loaded.system, observable, method, solver,
            tol=tol, seed=seed, threads=threads, seconds=seconds, step_pair=step_pair,
            cluster=cluster, checkpoint=checkpoint, partial=True, dt=dt,
            allow_unstable=allow_unstable,
        )  # fmt: skip
    except NotApplicable as reason:
        raise BadInput(f"{loaded.name}: {method} does not apply: {reason}") from None
    given = {"seed": seed, "tol": tol, "observable": of, "dt": dt, "step_pair": step_pair}
    checkpoint_folder(checkpoint, loaded, given)
    with progress_bar() as progress:
        result = solved(plan, loaded.system, [observable], progress=progress)
    record = density_record(loaded, result, points)
    if as_json:
        print_json(record)
    else:
        typer.echo(density_text(record))
    end_with([f"{of} is not certified: {f}" for f in record["certificate"]["failures"]])


app.command()(converge)
app.command()(cost)
app.command()(export)
app.command()(verify)
app.command()(regime)


def main() -> None:
    """Run the command line; everything a user can get wrong ends in one line and status 2."""
    with _one_line_errors():
        # Outside standalone mode typer hands usage errors over instead of printing four lines.
        sys.exit(app(standalone_mode=False) or 0)


@contextmanager
def _one_line_errors() -> Iterator[None]:
    try:
        yield
    except (KeyboardInterrupt, typer.Abort):
        _fail("stopped; nothing half-written was left", 130)
    except BrokenPipeError:
        sys.stderr.close()  # the reader has gone: say nothing more
        sys.exit(1)
    except Exception as error:
        if hasattr(error, "format_message"):  # a usage error of the command line itself
            _usage(error)
        status = _status(error)
        if status is None:
            raise
        _fail(str(error), status)


def _usage(error: Any) -> None:
    if type(error).__name__ == "NoArgsIsHelpError":
        typer.echo(error.format_message(), err=True)
        sys.exit(2)
    command = error.ctx.command_path if getattr(error, "ctx", None) else "fpk"
    _fail(f"{error.format_message()} ({command} --help says more)", 2)


def _status(error: Exception) -> int | None:
    """Return the exit status of an error made for users, None for a fault of the program."""
    from cases.scene.errors import BadInput
    from fpk.errors import InvalidInput, NotApplicable, NotCertified, Unavailable

    if isinstance(error, NotCertified):
        return 1
    return 2 if isinstance(error, (BadInput, InvalidInput, NotApplicable, Unavailable)) else None


def _fail(message: str, status: int) -> None:
    typer.echo("fpk: " + " ".join(message.split()), err=True)
    sys.exit(status)
