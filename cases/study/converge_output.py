"""A convergence study as tables, files and a picture."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from cases.fields import program_version
from cases.files import write_by, write_text
from cases.pictures.style import COLOURS, INK, STYLE
from cases.study.converge import COLUMNS, ConvergenceStudy, Studied
from cases.study.ladders import Ladder
from cases.study.tables import Table, markdown_text, shown, shown_order
from cases.study.weak import WeakOrder
from cases.svg import svg_text
from fpk.orders import LIMITS

GCI_WORDS = (
    "GCI: safety factor 1.25 where the observed order is within 10 % of theory, else 3. " + LIMITS
)


def study_tables(study: ConvergenceStudy) -> list[Table]:
    """Return errors and orders of every ladder, the functionals, the steps and the samples."""
    tables = []
    for studied in study.equations:
        tables += [_errors(studied), _orders(studied), _grid(studied)]
    if study.schemes:
        tables += [_steps(study.schemes), *([_samples(study)] if study.samples else [])]
    if study.refusals:
        rows = tuple(study.refusals.items())
        tables.append(Table("Routes that do not apply", ("route", "reason"), rows))
    return tables


def _errors(studied: Studied) -> Table:
    rows = [
        (
            ladder.name if k == 0 else "",
            level.label,
            str(level.unknowns),
            *(shown(level.errors[key]) for key in COLUMNS),
            shown(level.estimate),
        )
        for ladder in studied.ladders
        for k, level in enumerate(ladder.levels)
    ]
    return Table(
        f"{studied.equation}, p({studied.observable}): errors",
        ("family", "level", "unknowns", *COLUMNS, "its L1 estimate"),
        tuple(rows),
        (f"Against: {studied.reference}, itself within {studied.reference_error:.1e} in L1.",),
    )


def _orders(studied: Studied) -> Table:
    rows = []
    for ladder in studied.ladders:
        for k, key in enumerate(COLUMNS):
            v = ladder.verdicts[key]
            rows.append(
                (
                    ladder.name if k == 0 else "",
                    key,
                    " ".join(f"{o:.2f}" for o in v.orders) or "–",
                    shown_order(v.order, v.spread),
                    "–" if v.theory is None else f"{v.theory:g}",
                    v.kind,
                )
            )
    return Table(
        f"{studied.equation}: observed orders",
        ("family", "error", "consecutive levels", "last three", "theory", "verdict"),
        tuple(rows),
        (
            "In h: powers of h. In p: nats a degree. By tol: nats a unit of √unknowns. Levels"
            " within ten times the floor (error of the reference, end of the mesh) give no order.",
        ),
    )


def _grid(studied: Studied) -> Table:
    rows = [
        (
            ladder.name if k == 0 else "",
            key,
            f"{g.value:.10g}",
            shown_order(g.observed),
            f"{g.used:.2f}",
            f"{g.safety:g}",
            shown(g.index),
            shown(ladder.levels[-1].errors[key]),
            g.kind,
        )
        for ladder in studied.ladders
        for k, (key, g) in enumerate(ladder.grid.items())
    ]
    return Table(
        f"{studied.equation}: Richardson and grid convergence index (GCI)",
        (
            "family",
            "functional",
            "Richardson",
            "observed",
            "used",
            "factor",
            "GCI",
            "true error",
            "verdict",
        ),
        tuple(rows),
        (GCI_WORDS,),
    )


def _steps(schemes: tuple[WeakOrder, ...]) -> Table:
    rows, remarks = [], []
    for s in schemes:
        for k, level in enumerate(s.levels):
            rows.append(
                (
                    s.scheme if k == 0 else "",
                    f"{level.dt:.4g}",
                    f"{level.value:.6f}",
                    f"{level.error:.1e}",
                    shown(s.errors[k]),
                    shown(s.error_bars[k]),
                    f"{level.sampled:.2e}",
                )
            )
        remarks.append(_told(s))
    name = schemes[0].observable
    head = ("scheme", "dt", name, "one s.e.", "|error|", "its s.e.", "paths x time")
    return Table("Simulation: weak order in the step", head, tuple(rows), tuple(remarks))


def _told(s: WeakOrder) -> str:
    if s.verdict == "unstable":
        return f"{s.scheme}: no step was found that is stable and cheap enough to study."
    low, high = s.order_error
    base = "closed form" if s.known else "intercept of the regression"
    ratios = ", ".join(f"{o:.2f} ± {e:.2f}" for o, e in s.ratios) or "none resolved"
    words = (
        f"{s.scheme}: weak order {s.order:.2f} ({low:.2f} to {high:.2f}, one s.e.), theory"
        f" {s.theory}: {s.verdict}; consecutive ratios: {ratios}; chi² {s.chi2:.1f} of {s.freedom}"
        f" with the order of theory; limit {s.limit:.6f} ± {s.limit_error:.1e} ({base}); standard"
        f" error wanted {s.wanted:.1e}"
    )
    return words + (
        f", short of it by a factor {s.short:.1f} in the time given." if s.short > 1.05 else "."
    )


def _samples(study: ConvergenceStudy) -> Table:
    found = study.samples
    assert found is not None
    pairs = zip(found.sampled, found.errors, strict=True)
    rows = tuple((f"{n:.2e}", shown(e)) for n, e in pairs)
    words = f"slope {found.slope:.3f} ± {found.slope_error:.3f}, theory -0.5"
    return Table(
        f"Simulation: standard error of {found.observable} in samples",
        ("paths x time", "one s.e."),
        rows,
        (words,),
    )


def write_study(study: ConvergenceStudy, folder: Path) -> list[Path]:
    """Write ``converge.md``, ``converge.nc`` and ``converge.svg``; return their paths."""
    paths = [folder / f"converge.{ending}" for ending in ("md", "nc", "svg")]
    title = f"Convergence: {study.scene.title}"
    write_text(paths[0], markdown_text(title, study_tables(study)))
    data = study_dataset(study)
    write_by(paths[1], lambda temporary: data.to_netcdf(temporary, engine="h5netcdf"))
    write_text(paths[2], svg_text(study_figure(study), salt="converge"))
    return paths


def study_dataset(study: ConvergenceStudy) -> xr.Dataset:
    """Return one row a level: equation, family, settings, errors, estimate."""
    levels = [(s, la, v) for s in study.equations for la in s.ladders for v in la.levels]
    words = {
        "equation": [s.equation for s, _, _ in levels],
        "family": [la.name for _, la, _ in levels],
        "level_name": [v.label for _, _, v in levels],
    }
    data = xr.Dataset({key: ("level", np.array(value, dtype=str)) for key, value in words.items()})
    data["unknowns"] = ("level", np.array([v.unknowns for _, _, v in levels], dtype=int))
    for key in COLUMNS:
        data[f"error_{key.replace(' ', '_').replace('²', '2')}"] = (
            "level",
            np.array([v.errors[key] for _, _, v in levels], dtype=float),
        )
    data["estimate_L1"] = ("level", np.array([v.estimate for _, _, v in levels], dtype=float))
    steps = [(s.scheme, level) for s in study.schemes for level in s.levels]
    data["scheme"] = ("step", np.array([name for name, _ in steps], dtype=str))
    for key in ("dt", "value", "error", "sampled"):
        column = np.array([getattr(level, key) for _, level in steps], dtype=float)
        data[f"step_{key}"] = ("step", column)
    data.attrs = {
        "title": f"Convergence: {study.scene.title}",
        "scene": study.scene.name,
        "scene_file": study.scene.text,
        "program": f"vibro-fpk {program_version()}",
    }
    return data


def study_figure(study: ConvergenceStudy) -> Figure:
    """Draw L1 against unknowns for every equation, and the bias of every scheme against the step.

    Dashed lines have the slope of theory, through the finest level.
    """
    panels = len(study.equations) + bool(study.schemes)
    with mpl.rc_context(dict(STYLE)):
        figure = Figure(figsize=(4.4 * max(panels, 1), 3.9), layout="constrained")
        drawn = list(figure.subplots(1, max(panels, 1), squeeze=False)[0])
        for axes, studied in zip(drawn, study.equations, strict=False):
            _draw_ladders(axes, studied)
        if study.schemes:
            _draw_schemes(drawn[-1], study.schemes)
    return figure


def _draw_ladders(axes: Axes, studied: Studied) -> None:
    markers = "osD^v"
    axes.axhspan(1e-16, studied.reference_error + 1e-15, color=INK, alpha=0.08, lw=0)
    for ladder, colour, marker in zip(studied.ladders, COLOURS, markers, strict=False):
        N = np.array([level.unknowns for level in ladder.levels], dtype=float)
        e = np.array([level.errors["L1"] for level in ladder.levels])
        axes.plot(
            N, e, color=colour, marker=marker, markersize=3.6, lw=1.3, label=_label(ladder, studied)
        )
        if ladder.degree:
            dimension = 2 if "," in studied.observable else 1
            slope = N[-3:] / N[-1]
            axes.plot(
                N[-3:],
                0.6 * e[-1] * slope ** (-(ladder.degree + 1.0) / dimension),
                color=colour,
                lw=0.9,
                ls=(0, (4, 2)),
            )
    axes.set(xscale="log", yscale="log", xlabel="unknowns")
    axes.set_ylabel(f"$L_1$ error of $p({_symbols(studied.observable)})$")
    axes.set_ylim(1e-15, 10.0)
    axes.set_title(f"{studied.equation}")
    axes.text(
        0.985, 0.015, "error of the reference", transform=axes.transAxes, ha="right", fontsize=7.5
    )
    axes.legend(loc="lower left", fontsize=7.5, borderaxespad=1.6)


def _label(ladder: Ladder, studied: Studied) -> str:
    order = ladder.verdicts["L1"].order
    if not ladder.degree:
        return ladder.name
    return f"{ladder.name}: order {order:.2f}"


def _symbols(observable: str) -> str:
    return observable.replace("H1", "H_1").replace("H2", "H_2")


def _draw_schemes(axes: Axes, schemes: tuple[WeakOrder, ...]) -> None:
    drawn = [s for s in schemes if s.levels]
    for s, colour in zip(drawn, COLOURS, strict=False):
        dt = np.array([level.dt for level in s.levels])
        e, bar = np.array(s.errors), np.array(s.error_bars)
        low = np.minimum(bar, 0.9 * e)
        label = f"{s.scheme.replace('_', ' ')}: order {s.order:.1f}"
        axes.errorbar(
            dt, e, [low, bar], color=colour, marker="o", markersize=3.6, ls="", capsize=2, lw=1.0
        )
        fit = np.geomspace(dt.min(), dt.max(), 30)
        axes.plot(fit, abs(s.slope) * fit**s.theory, color=colour, lw=1.2, label=label)
    axes.set(xscale="log", yscale="log", xlabel="step $dt$")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_ylabel(f"error of ${_square(schemes[0].observable)}$, one standard error")
    axes.set_title("simulation; lines: order of theory")
    axes.legend(loc="best", fontsize=7.5)


def _square(name: str) -> str:
    return f"E\\,q_{{{name.removeprefix('E q').removesuffix('²')}}}^2"
