"""A convergence study as tables, files and a picture."""

from pathlib import Path

import numpy as np
import xarray as xr

from cases.output.fields import program_version
from cases.output.files import write_by, write_text
from cases.output.svg import svg_text
from cases.studies.converge import COLUMNS, ConvergenceStudy, Studied
from cases.studies.converge_picture import study_figure
from cases.studies.ladders import Ladder
from cases.studies.names import EXPLAINED
from cases.studies.tables import Table, markdown_text, shown, shown_order
from cases.studies.weak_fit import WeakOrder
from fpk.orders import LIMITS

GCI_WORDS = (
    "GCI: safety factor 1.25 where the observed order is within 10 % of theory, else 3. " + LIMITS
)

TWO_ENERGIES = (
    "Mean energy: with constant damping the drift is linear in the energies, which are test"
    " functions themselves, so that elements of any degree have E H right, and only the end of the"
    " mesh is seen: at the floor.",
    "Largest error of degree 1: it stands at H1 = H2 = 0, where b vanishes as the radial part of a"
    " Laplacian in the plane does, and theory there is h² |ln h|: observed orders near 2 only as"
    " 1/|ln h|, which no affordable mesh ends (Eriksson and Thomée, Math. Comp. 42, 1984, 345).",
)
"""Why two of the orders of (17) are not, and need not be, those of the column of theory."""


def study_tables(study: ConvergenceStudy) -> list[Table]:
    """Return errors and orders of every ladder, the functionals, the steps and the samples."""
    tables = []
    for studied in study.equations:
        tables += [_errors(studied), _orders(studied), _grid(studied)]
        if studied.theory == "nonintegrable":
            tables.append(_in_degree(studied, study.without_contact))
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
        (
            f"Against: {studied.reference}, itself within {studied.reference_error:.1e} in L1.",
            EXPLAINED[studied.dimension],
        ),
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
            *(TWO_ENERGIES if studied.dimension == 2 else ()),
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


def _in_degree(studied: Studied, without: Ladder | None) -> Table:
    """Errors by degree on a fixed mesh, with contact and without: nats of error a degree."""
    own = next(ladder for ladder in studied.ladders if ladder.family == "p")
    shown_ones = [("as it is", own), *([("without contact", without)] if without else [])]
    rows = [
        (words if k == 0 else "", level.label, str(level.unknowns), shown(level.errors["L1"]), rate)
        for words, ladder in shown_ones
        for k, (level, rate) in enumerate(zip(ladder.levels, rates(ladder), strict=True))
    ]
    head = ("system", "degree", "unknowns", "L1", "nats a degree")
    remarks = (
        "Nats: -ln of the ratio of neighbouring errors. Where they do not fall with the degree the"
        " error falls exponentially; a dash stands at the floor. The contact energies are nodes of"
        " the mesh, but above them the coefficients have half-integer powers of H - H_c: with"
        " contact a slower rate can take over at high degree, which hp elements, graded there, do"
        " without.",
    )
    return Table(f"{studied.equation}: exponential convergence in p", head, tuple(rows), remarks)


def rates(ladder: Ladder) -> list[str]:
    """Return the nats of error that a degree took off, by level; a dash where none is known."""
    orders = [f"{o:.2f}" for o in ladder.verdicts["L1"].orders]
    return ["–", *orders, *["–"] * (len(ladder.levels) - 1 - len(orders))]


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
    order = (
        f"no weak order: the best fit is at the end of those tried, {low:.2f} to {high:.2f}"
        if s.beyond
        else f"weak order {s.order:.2f} ({low:.2f} to {high:.2f}, one s.e.)"
    )
    words = (
        f"{s.scheme}: {order}, theory"
        f" {s.theory}: {s.verdict}; consecutive ratios: {ratios}; chi² {s.chi2:.1f} of {s.freedom}"
        f" with the order of theory; limit {s.limit:.6f} ± {s.limit_error:.1e} ({base}); standard"
        f" error wanted {s.wanted:.1e}"
    )
    if s.verdict == "pre-asymptotic" and not s.known:
        words += "; the errors above are from that intercept, which rests on a fit that fails"
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
