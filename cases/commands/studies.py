"""The commands ``fpk converge``, ``fpk cost`` and ``fpk regime``: studies of one scene."""

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cases.commands import parts

if TYPE_CHECKING:
    from cases.scene.scene import Scene
    from cases.studies.page import Page

study_folder = click.option(
    "--out", type=parts.FOLDER, help="Folder: tables (.md), numbers (.nc), picture (.svg)."
)


@click.command()
@parts.scene_name
@click.option("--route", help="nonintegrable, integrable or montecarlo; all if left out.")
@click.option("--of", metavar="OBS", help="H or H1,H2: the equation of that density.")
@study_folder
@click.option(
    "--seconds", type=click.FloatRange(0.1), help="Processor time for the steps of each scheme."
)
@parts.seed
@parts.threads
@parts.as_json
def converge(
    scene: str, route: str | None, of: str | None, out: Path | None, as_json: bool, **settings: Any
) -> None:
    """Measure orders of convergence: in h, in p, in both, in the step and in samples."""
    loaded = _begun(scene, out)
    from cases.studies.converge import chosen_routes, study_convergence
    from cases.studies.converge_page import convergence_page

    routes = chosen_routes(route, of)
    with parts.progress_bar() as progress:
        study = study_convergence(loaded, routes, progress=progress, **_given(settings))
    _end(study, convergence_page(study), out, as_json=as_json)


@click.command()
@parts.scene_name
@study_folder
@click.option(
    "--simulate/--no-simulate", default=True, help="With the sampling routes, or without."
)
@parts.seed
@parts.as_json
def cost(scene: str, out: Path | None, as_json: bool, **settings: Any) -> None:
    """Time every route whose answer agrees with the reference, and price each digit."""
    loaded = _begun(scene, out)
    from cases.studies.cost import study_cost
    from cases.studies.cost_page import cost_page

    with parts.progress_bar() as progress:
        study = study_cost(loaded, progress=progress, **_given(settings))
    _end(study, cost_page(study), out, as_json=as_json)


@click.command()
@parts.scene_name
@click.option(
    "--vary", multiple=True, required=True, metavar="KEY=LOW:HIGH:[log]COUNT", help="Once or twice."
)
@click.option("--out", type=parts.FOLDER, help="Folder for all files; a map goes on there.")
@parts.seed
@parts.threads
@click.option("--paths", type=int, help="Paths of the simulation.")
@click.option("--time", type=float, help="Sampled time a path.")
@parts.cluster
@click.option("--checkpoint", type=parts.FOLDER, help="Folder for finished points, if not --out.")
@parts.as_json
def regime(
    scene: str, vary: tuple[str, ...], out: Path | None, as_json: bool, **settings: Any
) -> None:
    """Map the distance of each theory to the full system over one or two parameters."""
    loaded = _begun(scene)
    from cases.output.files import make_folder
    from cases.studies.regime_map.map import SIMULATION, build_map, parse_axes

    axes = parse_axes(vary, loaded.system)
    store = settings.pop("checkpoint") or out
    for folder in filter(None, (out, store)):
        make_folder(folder)
    parts.check_cluster(settings["cluster"])
    from cases.studies.regime_map.map_page import map_page

    method = replace(SIMULATION, **_given(settings))
    with parts.progress_bar() as progress:
        result = build_map(loaded, axes, simulation=method, folder=store, progress=progress)
    _end(result, map_page(result), out, as_json=as_json)


def _begun(scene: str, out: Path | None = None) -> "Scene":
    """Load the scene and make the folder of a study.

    Linear algebra takes one thread from here on: small matrices gain nothing from more, and times
    of routes can be compared then and do not depend on load.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return parts.checked(scene, out=out)


def _given(settings: dict[str, Any]) -> dict[str, Any]:
    """Return the options that were given; for the others the defaults of the work itself hold."""
    return {key: value for key, value in settings.items() if value is not None}


def _end(study: Any, page: "Page", out: Path | None, *, as_json: bool) -> None:
    """Write a study's page to ``out``, print it or the JSON object, and say the problems."""
    from cases.output.records import plain

    written = [] if out is None else page.write(out)
    short = page.summary if written else ""
    record = plain(study.record()) if as_json else None
    parts.end(record, lambda: short or page.text().rstrip(), written, problems=study.problems)
