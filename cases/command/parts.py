"""Options, exit statuses and JSON output shared by the commands of ``fpk``; light to import."""

import json
import os
import re
import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial, reduce
from pathlib import Path
from shutil import get_terminal_size
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import click

from cases.command import completed
from cases.scene.errors import BadInput
from cases.scene.written import SCHEMA
from fpk.numeric.errors import InvalidInput

if TYPE_CHECKING:
    from cases.compare.stationary import Outcome
    from cases.scene.scene import Scene
    from fpk.answer.names import Observable


class NonEmptyPath(click.Path):
    """A path; the empty text, which would mean the working folder, is refused."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return the path; raise ``click.BadParameter`` for "", such as an unset shell variable."""
        if not os.fspath(value):
            self.fail('"" is no path; write "." for this folder', param, ctx)
        return super().convert(value, param, ctx)


FOLDER = NonEmptyPath(path_type=Path)

FIELDS = "result.nc"
"""Name of the netCDF file of a run in its folder."""

NARROWEST = 40
"""Columns of the narrowest terminal for which lines are wrapped."""

NORMS = ("L1", "L2")
"""Keys of JSON with a capital letter, part of the contract."""


scene_name = click.argument("scene", metavar="SCENE", shell_complete=completed.scenes)
as_json = click.option(
    "--json", "as_json", is_flag=True, expose_value=False, help="Print one JSON object alone.",
    callback=lambda context, option, value: context.meta.update(json=value),
)  # fmt: skip
of = partial(click.option, "--of", metavar="OBS", shell_complete=completed.observables)
method = partial(click.option, "--method", shell_complete=completed.methods)
out = partial(click.option, "--out", type=FOLDER)
checkpoint = partial(click.option, "--checkpoint", type=FOLDER)
tol = click.option("--tol", type=float, help="L1 error wanted; a solver adapts to meet it.")
seed = click.option("--seed", type=click.IntRange(0, 2**64 - 1), help="Seed of the simulation.")
threads = click.option("--threads", type=click.IntRange(1), help="Threads of the simulation.")
seconds = click.option("--seconds", type=float, help="Wall time of all simulations together, in s.")
dt = click.option("--dt", type=float, help="Step of the simulation; chosen if left out.")
cluster = click.option(
    "--cluster", metavar="ADDRESS", help="Simulate on the Dask cluster there: tcp://HOST:PORT."
)


def with_options(*options: Any) -> Callable[[Any], Any]:
    """Return a decorator that adds ``options`` to a command, in this order."""
    return lambda command: reduce(lambda own, option: option(own), reversed(options), command)


simulation_options = with_options(
    tol,
    seed,
    threads,
    seconds,
    click.option("--step-pair", is_flag=True, help="Simulate at half the step, too."),
    dt,
    click.option("--allow-unstable", is_flag=True, help="Take a --dt beyond the limit."),
    cluster,
    checkpoint(help="Keep the simulation's state there, go on from it."),
)


def command_line() -> str:
    """Return the running command as a line for a shell; options at their defaults are left out."""
    context = click.get_current_context()
    words = context.command_path.split()
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if isinstance(parameter, click.Argument):
            words.append(str(value))
        elif value is False and not parameter.secondary_opts:
            continue
        elif value not in (None, (), parameter.get_default(context)):
            given = list(value) if isinstance(value, tuple) else [value]
            for each in given:
                name = (parameter.secondary_opts if each is False else parameter.opts)[0]
                words += [name] if isinstance(each, bool) else [name, str(each)]
    return shlex.join(words)


def load_checked(scene: str, *, tol: float | None = None, out: Path | None = None) -> "Scene":
    """Return the scene of this name or path; check ``tol``, and make and lock the folder ``out``.

    The lock ends with the command. Raises ``BadInput`` for a scene, tolerance or folder that cannot
    be used, ``Unavailable`` if another command writes to the folder.
    """
    from cases.scene.scene import load_scene

    loaded = load_scene(scene)
    if tol is not None:
        from averaging.theory import LARGEST, SMALLEST

        if not SMALLEST <= tol <= LARGEST:
            raise BadInput(f"--tol {tol:g}: must be between {SMALLEST:g} and {LARGEST:g}")
    if out is not None:
        from cases.show.files import output_folder

        click.get_current_context().with_resource(output_folder(out))
    return loaded


def observable_of(name: str, scene: "Scene") -> "Observable":
    """Return the observable ``name`` of ``--of``; ``BadInput`` if the scene's system has none."""
    from fpk.answer.names import parse_observable

    observable: Observable = read("of", name, lambda: parse_observable(name, scene.system.n))
    return observable


def read(option: str, text: str, parse: Callable[[], Any]) -> Any:
    """Return ``parse()``; ``InvalidInput`` becomes ``BadInput`` naming ``option`` and ``text``."""
    try:
        return parse()
    except InvalidInput as error:
        raise BadInput(f'--{option} "{text}": {error.remedy}') from None


def only_observables(scene: "Scene", names: Sequence[str], *, whole: bool) -> "Scene":
    """Return a copy of the scene with the observables ``names`` alone, without questions in time.

    Without ``names`` both stay, and if all routes run (``whole``) the scene's claims, which are
    about all routes and observables, and ``densities_asked``, which is True with ``names``. Raises
    ``BadInput`` for a name of no observable.
    """
    if names:
        observables = tuple(dict.fromkeys(observable_of(name, scene) for name in names))
        scene = replace(scene, observables=observables, passages=(), transients=())
    asked = bool(names) or (whole and scene.densities_asked)
    expect = scene.expect if whole and not names else None
    return replace(scene, expect=expect, densities_asked=asked)


def checkpoint_folder(scene: "Scene", settings: Mapping[str, Any]) -> None:
    """Call ``claim_folder`` for ``settings["checkpoint"]``, if not None, until the command ends."""
    if settings["checkpoint"] is None:
        return
    from cases.show.claim import claim_folder
    from sim.sample.settings import NOT_IN_STATE

    own = {key: v for key, v in settings.items() if f"MonteCarlo.{key}" not in NOT_IN_STATE}
    context = claim_folder(settings["checkpoint"], {"scene": scene.text, "settings": own})
    click.get_current_context().with_resource(context)


def end(
    record: dict[str, Any],
    text: Callable[[], str],
    written: Sequence[Path] = (),
    *,
    problems: Sequence[str] = (),
    quiet: bool = False,
) -> None:
    """Print ``record`` as one JSON object with ``--json``, else ``text()`` and the files written.

    ``quiet``: neither text nor files. Each of ``problems`` is a line on standard error; with any,
    ``click.exceptions.Exit(1)`` is raised.
    """
    if click.get_current_context().meta["json"]:
        own = with_plain_keys({"schema": SCHEMA, **record})
        click.echo(json.dumps(own, ensure_ascii=False, allow_nan=False))
    elif not quiet:
        # A path is printed whole: it is to be copied.
        click.echo("\n".join([as_wide(text()), *(f"wrote {path}" for path in written)]))
    if problems:
        from cases.show.words import reader_words

        for problem in problems:
            click.echo(f"fpk: {reader_words(problem)}", err=True)
        raise click.exceptions.Exit(1)


def with_plain_keys(record: Any) -> Any:
    """Return a copy with all keys, at any depth, in snake_case and ASCII, except ``L1``, ``L2``.

    ``E q1²`` becomes ``mean_q1_squared``; keys that would coincide stay as they are.
    """
    if isinstance(record, list):
        return [with_plain_keys(entry) for entry in record]
    if not isinstance(record, dict):
        return record
    keys = {}
    for key in record:
        words = re.sub(r"\bE (?=[a-z])", "mean ", key).replace("²", " squared").lower()
        keys[key] = key if key in NORMS else re.sub(r"[^a-z0-9]+", "_", words).strip("_")
    names = Counter(keys.values())
    return {
        keys[key] if names[keys[key]] == 1 else key: with_plain_keys(value)
        for key, value in record.items()
    }


def as_wide(text: str) -> str:
    """Return ``text`` wrapped to the width of the terminal, lines continued with an indent.

    Unchanged if the output is a file, a pipe, or a terminal narrower than ``NARROWEST``.
    """
    width = get_terminal_size((0, 0)).columns
    if width < NARROWEST:
        return text
    how: Any = {"break_long_words": False, "break_on_hyphens": False, "expand_tabs": False}
    lines: list[str] = []
    for line in text.split("\n"):
        indent = " " * (len(line) - len(line.lstrip()) + 4)
        long = len(line) > width
        lines += wrap(line, width, subsequent_indent=indent, **how) if long else [line]
    return "\n".join(lines)


def outcome_of(scene: "Scene", methods: Any, **settings: Any) -> "Outcome":
    """Run ``scene`` by ``methods`` under a progress bar, with ``settings`` of ``run_scene``."""
    from cases.compare.stationary import run_scene
    from cases.show.bar import progress_bar

    with progress_bar() as progress:
        return run_scene(scene, methods, progress=progress, **settings)


def check_cluster(address: str | None) -> None:
    """Raise ``Unavailable`` if no usable Dask cluster answers at ``address``; None: do nothing."""
    if address is not None:
        from sim.sample.workers import workers_of

        with workers_of(address):
            pass
