"""The record and the text of ``fpk density``."""

from typing import Any

import numpy as np

from cases.output.records import certificate_record, plain
from cases.scene.scene import Scene
from fpk.density import Array
from fpk.method import Result

Record = dict[str, Any]


def density_record(scene: Scene, result: Result, points: tuple[Array, ...]) -> dict[str, Any]:
    """Return the record of ``fpk density`` at ``points``, one array per axis."""
    density = result.densities[0]
    values, errors = density.at(*points)
    record: dict[str, Any] = plain(
        {
            "scene": scene.name,
            "method": result.method.name,
            "solver": result.method.solver,
            "observable": density.name,
            "points": points[0] if len(points) == 1 else np.stack(points, axis=-1),
            "density": values,
            "error": errors,
            "error_kind": density.error_kind,
            "certificate": certificate_record(density),
            "settings": dict(result.settings),
            "seconds": result.seconds,
        }
    )
    return record


def density_text(record: Record) -> str:
    """Return the points, the density and its error in columns."""
    kind = "one standard error" if record["error_kind"] == "sampling" else "numerical error"
    lines = [f"# {record['observable']}   density   {kind}"]
    for point, value, error in zip(
        record["points"], record["density"], record["error"], strict=True
    ):
        at = point if isinstance(point, list) else [point]
        words = ["nan" if x is None else f"{x:.12g}" for x in (*at, value)]
        lines.append("  ".join([*words, "nan" if error is None else f"{error:.2g}"]))
    return "\n".join(lines)
