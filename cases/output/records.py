"""Plain records: what JSON has of numbers, arrays and the program's own records."""

from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from pydantic_core import to_jsonable_python

from cases.scene.scene import Scene
from fpk.arrays import Array
from fpk.method import Result

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
            "certificate": {
                **vars(density.certificate),
                "certified": density.certificate.certified,
            },
            "settings": dict(result.settings),
            "seconds": result.seconds,
        }
    )


def density_text(record: Record) -> str:
    """Return the points, the density and its error in columns."""
    kind = "one standard error" if record["error_kind"] == "sampling" else "numerical error"
    lines = [f"# {record['observable']}   density   {kind}"]
    rows = zip(record["points"], record["density"], record["error"], strict=True)
    for point, value, error in rows:
        at = point if isinstance(point, list) else [point]
        words = ["nan" if x is None else f"{x:.12g}" for x in (*at, value)]
        lines.append("  ".join([*words, "nan" if error is None else f"{error:.2g}"]))
    return "\n".join(lines)
