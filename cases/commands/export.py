"""The command ``fpk export``: the densities of a scene in a file for other programs."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from cases.commands.parts import Json, SceneName, Tol, check_tol, end_with, outcome_of, print_json

ENDINGS = (".vtu", ".pvd", ".nc", ".csv")


def export(
    scene: SceneName,
    out: Annotated[Path, typer.Option(help="File to write: .vtu, .pvd, .nc or .csv.")],
    of: Annotated[
        str | None, typer.Option(metavar="OBS", help="This density instead of the scene's own.")
    ] = None,
    tol: Tol = None,
    as_json: Json = False,
) -> None:
    """Write the densities of a scene by theory, of all its curves, to one file.

    A .vtu holds one field of the scene's own system (the first pair observed, else the first
    density); a .pvd collects one .vtu for every density and curve.
    """
    from cases.output.files import make_folder
    from cases.scene.errors import BadInput
    from cases.scene.scene import load_scene
    from fpk.errors import InvalidInput
    from fpk.observable import parse_observable

    loaded = load_scene(scene)
    check_tol(tol)
    if out.suffix not in ENDINGS:
        raise BadInput(f"--out {out}: the ending says the format; use {', '.join(ENDINGS)}")
    if not out.parent.is_dir():
        raise BadInput(f"--out {out}: the folder {out.parent} does not exist")
    make_folder(out.parent)  # one that cannot be written is refused before the work
    if of is not None:
        try:
            loaded = replace(loaded, observables=(parse_observable(of, loaded.system.n),))
        except InvalidInput as error:
            raise BadInput(f'--of "{of}": {error.remedy}') from None
    if out.suffix == ".vtu":
        first = next((o for o in loaded.observables if len(o) == 2), loaded.observables[0])
        loaded = replace(loaded, observables=(first,), curves=loaded.curves[:1])
    from cases.comparison.routes import all_methods
    from cases.output.fields import write_csv, write_netcdf
    from cases.output.vtk import write_pvd, write_vtu

    loaded = replace(loaded, expect=None)  # without the simulation nothing can be claimed
    methods = [m for m in all_methods(tol=tol) if not m.route.sampled or m.route.solves != "full"]
    outcome = outcome_of(loaded, methods)
    write = {".vtu": write_vtu, ".pvd": write_pvd, ".nc": write_netcdf, ".csv": write_csv}
    written = write[out.suffix](outcome, out)
    if as_json:
        files = [str(path) for path in written]
        record = {"scene": loaded.name, "file": str(out), "files": files}
        print_json({**record, "seconds": outcome.seconds})
    else:
        for path in written:
            typer.echo(f"wrote {path}")
    end_with(outcome.problems)
