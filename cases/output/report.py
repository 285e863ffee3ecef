"""The report of a run: one self-contained page, the pictures beside it, the fields as netCDF."""

import platform
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from cases.comparison.claims import ACCEPTABLE_L1, ALMOST_KURTOSIS, ALMOST_L1
from cases.comparison.run import Outcome
from cases.output.digest import curves_of, digest_of, refusals_of, verdict_of
from cases.output.fields import write_netcdf
from cases.output.figures import figures
from cases.output.files import write_text
from cases.output.records import program_version
from cases.output.show import term_text, theories
from cases.output.svg import inline_svg, svg_text

LIBRARIES = ("numpy", "scipy", "scikit-fem", "numba", "matplotlib", "xarray")

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def write_report(outcome: Outcome, folder: Path) -> list[Path]:
    """Write ``report.html``, ``result.nc`` and the pictures into ``folder``; return their paths.

    Every file appears whole or not at all. Raises ``BadInput`` where the folder cannot be written.
    """
    pictures, written = [], []
    for stem, caption, figure in figures(outcome):
        svg = svg_text(figure, salt=stem)
        written.append(folder / f"{stem}.svg")
        write_text(written[-1], svg)
        pictures.append({"stem": stem, "caption": caption, "svg": inline_svg(svg, caption)})
    write_netcdf(outcome, folder / "result.nc")
    write_text(folder / "report.html", report_html(outcome, pictures))
    return [folder / "report.html", folder / "result.nc", *written]


def report_html(outcome: Outcome, pictures: list[dict[str, Any]]) -> str:
    """Return the page; every text that comes from a scene is escaped by the template."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"num": number, "reasons": refusals_of, "term": term_text}
    digest = digest_of(outcome)
    return environment.get_template("report.html").render(
        scene=outcome.scene,
        digest=digest,
        curves=curves_of(digest),
        verdict=verdict_of(digest),
        theories=theories(outcome.scene),
        pictures=pictures,
        limits={
            "gaussian": ALMOST_L1,
            "kurtosis": ALMOST_KURTOSIS,
            "acceptable": ACCEPTABLE_L1,
        },
        made=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        versions=[
            ("vibro-fpk", program_version()),
            ("Python", platform.python_version()),
            *((name, version(name)) for name in LIBRARIES),
        ],
    )


def number(value: Any, digits: int = 3) -> str:
    """Return a number as a table shows it: plain where it is short, else with a power of ten."""
    if value is None:
        return "–"
    if isinstance(value, (list, tuple)):
        return ", ".join(number(v, digits) for v in value)
    if not isinstance(value, float):
        return str(value)
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    if value == 0 or -3 <= int(exponent or 0) < 5:
        return f"{value:.{digits + 1}g}"
    return f"{mantissa} × 10{str(int(exponent)).translate(SUPERSCRIPTS)}"
