"""Commands that run all routes of a scene, or study it.

These are ``fpk converge``, ``cost``, ``regime``, ``sweep``, ``verify`` and ``export``.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import wraps
from itertools import product
from pathlib import Path
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Any, get_args

import click

from cases.command import parts
from cases.scene.errors import BadInput
from cases.study import STUDIES
from fpk.numeric.errors import NotApplicable

if TYPE_CHECKING:
    from cases.scene.scene import Scene
    from fpk.answer.method import Method

USUAL, COARSE, COARSE_PATHS = 38.0, 5.0, 4096
"""Relaxation times sampled on each path by ``fpk verify`` and with ``--coarse``, and the paths with
``--coarse``. ``fpk run`` takes four times the first: a shorter simulation has wider bands."""
VERIFY_SECONDS = 300.0
"""Seconds that ``fpk verify`` gives to a simulation of a scene whose simulations are expected to
need more in all (twice the third slowest shipped scene); an answer that is cut fails."""
FULL_WORK = 5e10
"""Largest number of multiplications of a solution of the full equation in ``fpk verify``: about a
second, with an error below the sampling error."""


def study(work: Callable[..., Any]) -> click.Command:
    """Return the command of a study ``work(scene, progress=…, **options)``.

    ``work`` returns a result with ``record()``, ``page()`` and ``problems``. Options that the user
    leaves out are not passed on: the defaults of ``work`` hold.
    """

    @click.command()
    @parts.scene_name
    @parts.out(help="Folder: tables (.md), numbers (.nc), picture (.svg), .html.")
    @parts.seed
    @parts.as_json
    @wraps(work)
    def command(scene: str, out: Path | None, **settings: Any) -> None:
        loaded = parts.load_checked(scene, tol=settings.get("tol"), out=out)
        given = {key: value for key, value in settings.items() if value is not None}
        from cases.show.bar import progress_bar
        from cases.show.records import plain

        with progress_bar() as progress:
            result = work(loaded, progress=progress, **given)
        from sim.montecarlo import MonteCarlo

        seed = "" if "seed" in given else f" --seed {MonteCarlo.seed}"
        page = result.page()
        written = [] if out is None else page.write(out, command=parts.command_line() + seed)
        short, width = page.summary if written else "", get_terminal_size((0, 0)).columns
        record = plain(result.record())
        parts.end(record, lambda: short or page.shown(width), written, problems=result.problems)

    return command


def command_of(name: str) -> click.Command | None:
    """Return the command of the study registered as ``name`` in ``STUDIES``, else None."""
    own = STUDIES.get(name)
    if own is None:
        return None

    def work(scene: "Scene", **settings: Any) -> Any:
        from cases.study.converge import study_own

        return study_own(own, scene, **settings)

    work.__name__, work.__doc__ = own.name, own.help
    return study(work)


@study
@click.option("--route", help="nonintegrable, integrable or montecarlo; all if left out.")
@parts.of(help="H or H1,H2: the equation of that density.")
@click.option(
    "--seconds", type=click.FloatRange(0.1), help="Processor time for the steps of each scheme."
)
@click.option(
    "--solver", type=click.Choice(["fem", "scikit-fem"]), help="Elements on given meshes by this."
)
@parts.threads
def converge(
    scene: "Scene", route: str | None = None, of: str | None = None, **settings: Any
) -> Any:
    """Measure orders of convergence: in h, in p, in both, in the step and in samples."""
    from cases.study.converge import chosen_routes, study_convergence

    return study_convergence(scene, chosen_routes(route, of), **settings)


@study
@click.option(
    "--simulate/--no-simulate",
    "--simulation/--no-simulation",
    default=True,
    help="With the sampling routes, or without.",
)
def cost(scene: "Scene", **settings: Any) -> Any:
    """Time every route whose answer agrees with the reference, and price each digit.

    For the full system it says below which error its equation is solved in less time than sampled.
    """
    from cases.study.cost import study_cost

    return study_cost(scene, **settings)


over_grid = parts.with_options(
    click.option(
        "--vary", multiple=True, required=True, metavar="PATH=GRID",
        help="Once or twice: contact[1].clearance, system.mass[2], ... = LOW:HIGH:[log]COUNT"
        " or 0.1,0.2.",
    ),
    parts.threads,
    click.option("--paths", type=int, help="Paths of the simulation."),
    click.option("--time", type=float, help="Sampled time a path."),
    parts.cluster,
    parts.checkpoint(help="Folder for finished points, if not --out."),
    click.option(
        "--reference",
        type=click.Choice(["montecarlo", "phase-space"]),
        help="What judges the theories where (6) has no exact density; default: montecarlo.",
    ),
)  # fmt: skip


def _over_grid(settings: dict[str, Any]) -> dict[str, Any]:
    """The arguments of a study over a grid from ``settings``, from which entries are removed."""
    from cases.study.sweep.answering import SIMULATION

    own = ("reference", "progress", "tol")
    given: dict[str, Any] = {key: settings.pop(key) for key in own if key in settings}
    folder = settings.pop("checkpoint", None) or click.get_current_context().params["out"]
    parts.check_cluster(settings.get("cluster"))
    return {**given, "folder": folder, "simulation": replace(SIMULATION, **settings)}


@study
@over_grid
def regime(scene: "Scene", vary: tuple[str, ...], **settings: Any) -> Any:
    """Map the distance of each theory to the full system over one or two parameters.

    A map goes on from the finished points in its folder.
    """
    from cases.study.regime_map import build_map

    return build_map(scene, vary, **_over_grid(settings))


@study
@over_grid
@click.option(
    "--quantity", multiple=True, required=True, metavar="Q",
    help="rms(q2), quantile(q2,0.99), correlation(q1,q2), mean_force(1), upcrossing_rate(1,left),"
    " failure_rate(H=1.5), averaging_error(q2), ...",
)  # fmt: skip
@parts.method(
    multiple=True,
    metavar="METHOD[/SOLVER]",
    help="One of several; left out, all that take milliseconds.",
)
@parts.tol
def sweep(
    scene: "Scene",
    vary: tuple[str, ...],
    quantity: tuple[str, ...],
    method: tuple[str, ...],
    **settings: Any,
) -> Any:
    """Compute quantities by several methods over one or two numbers of the scene.

    A sweep goes on from the finished points in its folder.
    """
    from cases.study.sweep.sweep import sweep as sweep_system

    return sweep_system(scene, vary, quantity, methods=method, **_over_grid(settings))


@click.command()
@click.argument("scenes", nargs=-1, metavar="[SCENE]...")
@click.option("--coarse", is_flag=True, help="A quick look: a still shorter simulation.")
@click.option(
    "--solver", multiple=True, help="With this solver too, of those taken only where named."
)
@parts.seed
@parts.threads
@parts.as_json
def verify(scenes: tuple[str, ...], coarse: bool, solver: tuple[str, ...], **settings: Any) -> None:
    """Run scenes by every route and judge them: one line each, one final table.

    SCENE: names or paths; without any all shipped scenes except cases/hard.
    """
    from cases.scene.scene import load_scene, shipped_scenes

    shipped = [name for name, path in shipped_scenes().items() if path.parent.name != "hard"]
    loaded = [load_scene(name) for name in dict.fromkeys(scenes or shipped)]
    from cases.compare.claims import Verdict
    from cases.compare.routes import all_methods, all_routes
    from cases.show.digest import digest_of, verify_row
    from cases.show.text import render

    if coarse:
        settings |= {"paths": COARSE_PATHS}
    relaxations = COARSE if coarse else USUAL
    if unknown := set(solver) - {route.solver for route in all_routes()}:
        raise BadInput(f"--solver {unknown.pop()}: is not a solver of any method")
    methods = all_methods(named=solver, relaxations=relaxations, work=FULL_WORK, **settings)
    width = max(len(scene.name) for scene in loaded)
    rows = []
    for scene in loaded:
        rows.append(verify_row(digest_of(parts.outcome_of(scene, _within_longest(methods, scene)))))
        if not click.get_current_context().meta["json"]:
            click.echo(render("verify_line.txt", {"row": rows[-1], "width": width}))
    verdicts = [claim["verdict"] for row in rows for claim in row["claims"]]
    parts.end(
        {
            "scenes": rows,
            "holds": all(row["holds"] for row in rows),
            "claims": {word: verdicts.count(word) for word in get_args(Verdict)},
            "seconds": sum(row["seconds"] for row in rows),
        },
        lambda: render("verify.txt", {"rows": rows}),
        problems=[f"{row['scene']}: {problem}" for row in rows for problem in row["problems"]],
    )


def _within_longest(methods: Sequence["Method"], scene: "Scene") -> list["Method"]:
    """Return ``methods``, each simulation limited to ``VERIFY_SECONDS`` if all together, over all
    curves of the scene, are expected to take longer."""
    from sim.montecarlo import MonteCarlo
    from sim.sample.settings import estimate_seconds

    expected, simulations = 0.0, [m for m in methods if isinstance(m, MonteCarlo)]
    for method, curve in product(simulations, scene.curves):
        with suppress(NotApplicable):  # such a simulation takes no time
            expected += estimate_seconds(method, curve.system)
    if expected <= VERIFY_SECONDS:
        return list(methods)
    limit: dict[str, Any] = {"seconds": VERIFY_SECONDS}
    return [replace(m, **limit) if hasattr(m, "seconds") else m for m in methods]  # type: ignore[type-var]


@click.command()
@parts.scene_name
@parts.out(required=True, help="File to write: .vtu, .pvd, .nc or .csv.")
@parts.of(help="This density instead of the scene's own.")
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
    loaded = parts.load_checked(scene, tol=tol)
    from cases.show.fields import WRITERS
    from cases.show.files import make_folder
    from cases.show.vtk import write_pvd, write_vtu

    writers = {".vtu": write_vtu, ".pvd": write_pvd, **WRITERS}
    if out.suffix not in writers:
        raise BadInput(f"--out {out}: the ending says the format; use {', '.join(writers)}")
    if of is not None:
        loaded = replace(loaded, observables=(parts.observable_of(of, loaded),))
    make_folder(out.parent)  # one that cannot be written is refused before the work
    if out.suffix == ".vtu":
        first = next((o for o in loaded.observables if len(o) == 2), loaded.observables[0])
        loaded = replace(loaded, observables=(first,), curves=loaded.curves[:1])
    from cases.compare.routes import all_methods

    # Claims, and the demand for every density, are about runs of all routes.
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
    files = [str(path) for path in writers[out.suffix](outcome, out)]
    record = {"scene": loaded.name, "file": str(out), "files": files, "seconds": outcome.seconds}
    words = "\n".join(f"wrote {file}" for file in files)
    parts.end(record, lambda: words, problems=outcome.problems)
