"""Plain records: what JSON has of numbers, arrays and the program's own records."""

from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from pydantic_core import to_jsonable_python

from cases.scene.scene import Scene
from fpk.arrays import Array
from fpk.certificate import Certificate
from fpk.dynamics import Curve, Rates
from fpk.evolution import Passage, Transient
from fpk.limit import Limit
from fpk.method import Method, Result
from fpk.observable import Observable, observable_name
from fpk.start import Start

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
    own = {
        "observable": density.name,
        "points": _listed(points),
        "density": values,
        "error": errors,
        "error_kind": density.error_kind,
    }
    facts = density.certificate, result.settings, result.seconds
    return _record(scene, result.method, own, *facts)


def curve_record(
    scene: Scene,
    method: Method,
    observable: Observable,
    points: Array,
    key: str,
    curve: Curve,
    seconds: float,
) -> Record:
    """Return the record of a curve of the stationary motion; its values are under ``key``."""
    own = {
        "observable": observable_name(observable),
        "points": points,
        key: curve.values,
        "error": curve.errors,
        "error_kind": curve.error_kind,
    }
    return _record(scene, method, own, curve.certificate, curve.settings, seconds)


def rates_record(scene: Scene, method: Method, rates: Rates, seconds: float) -> Record:
    """Return the record of ``fpk relaxation``."""
    own = {
        "rates": rates.values.real,
        "frequencies": rates.values.imag,
        "errors": rates.errors,
    }
    return _record(scene, method, own, rates.certificate, rates.settings, seconds)


def transient_record(
    scene: Scene,
    observable: Observable,
    start: Start,
    points: tuple[Array, ...],
    method: Method,
    answer: Transient,
    seconds: float,
) -> Record:
    """Return the record of ``fpk transient``: ``density`` and ``error`` have a list per time."""
    own = {
        "observable": observable_name(observable),
        "start": str(start),
        "times": answer.times,
        "points": _listed(points),
        "density": answer.values,
        "error": answer.errors,
        "error_kind": answer.error_kind,
    }
    return _record(scene, method, own, answer.certificate, answer.settings, seconds)


def passage_record(
    scene: Scene, limit: Limit, start: Start, method: Method, answer: Passage, seconds: float
) -> Record:
    """Return the record of ``fpk passage``; numbers that there are not, or beyond range, are null.

    ``failure`` is P(T <= t), whose relative digits 1 − survival has lost.
    """
    own = {"limit": str(limit), "start": str(start), **passage_numbers(answer)}
    own["error_kind"] = answer.error_kind
    if answer.starts is not None:
        own["starts"] = vars(answer.starts)
    return _record(scene, method, own, answer.certificate, answer.settings, seconds)


def passage_numbers(answer: Passage) -> Record:
    """Return the moments, the failure rate and the reliability with their errors."""
    own = {
        "mean": answer.mean.value,
        "mean_error": answer.mean.error,
        "variance": answer.variance.value,
        "variance_error": answer.variance.error,
        "rate": answer.rate and answer.rate.value,
        "rate_error": answer.rate and answer.rate.error,
        "times": answer.times,
        "survival": answer.survival,
        "survival_error": answer.survival_error,
    }
    if answer.failure is not None:
        own |= {"failure": answer.failure, "failure_error": answer.failure_error}
    return own


def _listed(points: tuple[Array, ...]) -> Array:
    return points[0] if len(points) == 1 else np.stack(points, axis=-1)


def _record(
    scene: Scene,
    method: Method,
    own: Record,
    certificate: Certificate,
    settings: Mapping[str, str | float | int],
    seconds: float,
) -> Record:
    """Return what all answers say, with their ``own`` in the middle."""
    head = {"scene": scene.name, "method": method.name, "solver": method.solver}
    return plain({**head, **own, **answer_tail(certificate, settings, seconds)})


def answer_tail(
    certificate: Certificate, settings: Mapping[str, str | float | int], seconds: float
) -> Record:
    """Return what every answer says last."""
    own = {"certificate": _certificate(certificate), "settings": dict(settings)}
    return {**own, "seconds": seconds}


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


def transient_text(record: Record) -> str:
    """Return the times, the points, the density and its error in columns."""
    kind = "one standard error" if record["error_kind"] == "sampling" else "numerical error"
    lines = [f"# time   {record['observable']}   density   {kind}"]
    for time, density, errors in zip(
        record["times"], record["density"], record["error"], strict=True
    ):
        for point, value, error in zip(record["points"], density, errors, strict=True):
            at = point if isinstance(point, list) else [point]
            lines.append(_row([time, *at, value], error))
    return "\n".join(lines)


def passage_text(record: Record) -> str:
    """Return the moments and the failure rate, and the reliability at the times in columns."""
    kind = "one standard error" if record["error_kind"] == "sampling" else "numerical error"
    lines = [f"# first passage of {record['limit']} from {record['start']}   {kind}"]
    for key in ("mean", "variance", "rate"):
        lines.append(f"{key:8}  " + _row([record[key]], record[f"{key}_error"]))
    if record["times"]:
        lines.append(f"# time   survival   {kind}")
        rows = zip(record["times"], record["survival"], record["survival_error"], strict=True)
        lines += [_row([time, value], error) for time, value, error in rows]
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
