"""The command ``fpk export``: the densities of a scene in a file for other programs."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from cases.commands import completed, parts
from cases.scene.errors import BadInput

ENDINGS = (".vtu", ".pvd", ".nc", ".csv")


@click.command()
@parts.scene_name
@click.option(
    "--out", type=parts.FOLDER, required=True, help="File to write: .vtu, .pvd, .nc or .csv."
)
@click.option(
    "--of", metavar="OBS", help="This density instead of the scene's own.",
    shell_complete=completed.observables,
)  # fmt: skip
@parts.tol
@click.option("--simulate", is_flag=True, help="With the simulation of the full system.")
@parts.seed
@parts.seconds
@parts.threads
@parts.as_json
def export(
    scene: str, out: Path, of: str | None, tol: float | None, simulate: bool, **settings: Any
) -> None:
    """Write the densities of a scene by theory, of all its curves, to one file.

    A .vtu holds one field of the scene's own system (the first pair observed, else the first
    density), and beside it the stops as planes; a .pvd collects one .vtu for every curve, one for
    every density.
    """
    loaded = parts.checked(scene, tol=tol)
    from cases.output.files import make_folder

    if out.suffix not in ENDINGS:
        raise BadInput(f"--out {out}: the ending says the format; use {', '.join(ENDINGS)}")
    if of is not None:
        loaded = replace(loaded, observables=(parts.observable_of(of, loaded),))
    make_folder(out.parent)  # one that cannot be written is refused before the work
    if out.suffix == ".vtu":
        first = next((o for o in loaded.observables if len(o) == 2), loaded.observables[0])
        loaded = replace(loaded, observables=(first,), curves=loaded.curves[:1])
    from cases.comparison.routes import all_methods
    from cases.output.fields import write_csv, write_netcdf
    from cases.output.vtk import write_pvd, write_vtu

    # Without all routes nothing can be claimed, and a density may be left out.
    loaded = replace(loaded, expect=None, densities_asked=False)
    methods = [
        m
        for m in all_methods(tol=tol, **settings)
        if (simulate and m.route.method == "montecarlo")
        or m.route.solves != "full"
        or (m.route.quick and not m.route.sampled)
    ]
    outcome = parts.outcome_of(loaded, methods)
    if not any(map(len, outcome.curves)):
        reason = f"no stationary density: {outcome.curves[0].absence}"
        raise BadInput(f"{loaded.name}: {[*outcome.problems, reason][0]}")
    write = dict(zip(ENDINGS, (write_vtu, write_pvd, write_netcdf, write_csv), strict=True))
    files = [str(path) for path in write[out.suffix](outcome, out)]
    record = {"scene": loaded.name, "file": str(out), "files": files, "seconds": outcome.seconds}
    words = "\n".join(f"wrote {file}" for file in files)
    parts.end(record, lambda: words, problems=outcome.problems)
