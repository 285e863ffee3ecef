"""Plain records: what JSON has of numbers, arrays and the program's own records."""

from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from pydantic_core import to_jsonable_python

from cases.scene.scene import Scene
from fpk.arrays import Array
from fpk.certificate import Certificate
from fpk.dynamics import Curve, Rates
from fpk.method import Method, Result
from fpk.observable import Observable, observable_name

Record = dict[str, Any]

UNITS = "the scene's own consistent units"


def program_version() -> str:
    """Return the version of the installed distribution."""
    try:
        return version("vibro-fpk")
    except PackageNotFoundError:
        return "(not installed)"


def plain(record: Any) -> Record:
    """Return a dictionary, or the fields of a record, as JSON has them: arrays become lists.

    What is not finite becomes null.
    """
    json_values: Record = to_jsonable_python(
        record, inf_nan_mode="null", fallback=lambda array: array.tolist()
    )
    return json_values


def density_record(scene: Scene, result: Result, points: tuple[Array, ...]) -> Record:
    """Return the record of ``fpk density`` at ``points``, one array per axis."""
    density = result.densities[0]
    values, errors = density.at(*points)
    return plain(
        {
            "scene": scene.name,
            "method": result.method.name,
            "solver": result.method.solver,
            "observable": density.name,
            "points": points[0] if len(points) == 1 else np.stack(points, axis=-1),
            "density": values,
            "error": errors,
            "error_kind": density.error_kind,
            "certificate": _certificate(density.certificate),
            "settings": dict(result.settings),
            "seconds": result.seconds,
        }
    )


def curve_record(
    scene: Scene,
    method: Method,
    observable: Observable,
    points: Array,
    key: str,
    curve: Curve,
    seconds: float,
) -> Record:
    """Return the record of ``fpk crossings`` and ``fpk spectrum``; the values are under ``key``."""
    return plain(
        {
            "scene": scene.name,
            "method": method.name,
            "solver": method.solver,
            "observable": observable_name(observable),
            "points": points,
            key: curve.values,
            "error": curve.errors,
            "error_kind": curve.error_kind,
            "certificate": _certificate(curve.certificate),
            "settings": dict(curve.settings),
            "seconds": seconds,
        }
    )


def rates_record(scene: Scene, method: Method, rates: Rates, seconds: float) -> Record:
    """Return the record of ``fpk relaxation``."""
    return plain(
        {
            "scene": scene.name,
            "method": method.name,
            "solver": method.solver,
            "rates": rates.values.real,
            "frequencies": rates.values.imag,
            "errors": rates.errors,
            "certificate": _certificate(rates.certificate),
            "settings": dict(rates.settings),
            "seconds": seconds,
        }
    )


def _certificate(certificate: Certificate) -> Record:
    return {**vars(certificate), "certified": certificate.certified}


def density_text(record: Record) -> str:
    """Return the points, the density and its error in columns."""
    return curve_text(record, "density")


def curve_text(record: Record, key: str) -> str:
    """Return the points, the values under ``key`` and their error in columns."""
    kind = "one standard error" if record["error_kind"] == "sampling" else "numerical error"
    lines = [f"# {record['observable']}   {key}   {kind}"]
    rows = zip(record["points"], record[key], record["error"], strict=True)
    for point, value, error in rows:
        at = point if isinstance(point, list) else [point]
        lines.append(_row([*at, value], error))
    return "\n".join(lines)


def rates_text(record: Record) -> str:
    """Return the rates, their frequencies and errors in columns."""
    rows = zip(record["rates"], record["frequencies"], record["errors"], strict=True)
    lines = [_row([rate, frequency], error) for rate, frequency, error in rows]
    end = record["settings"].get("sought up to the modulus")
    lines += [f"# rates of a modulus above {end:.3g} may be missing"] if end else []
    return "\n".join(["# rate   angular frequency   numerical error", *lines])


def _row(values: list[float | None], error: float | None) -> str:
    words = ["nan" if x is None else f"{x:.12g}" for x in values]
    return "  ".join([*words, "nan" if error is None else f"{error:.2g}"])
