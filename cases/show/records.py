"""Records of answers with plain values as JSON has them, and these records as text."""

from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from pydantic_core import to_jsonable_python

from cases.compare.doubt import averaging_notes
from cases.scene.scene import Scene
from cases.scene.units import DIMENSIONS, Units, in_brackets
from cases.scene.written import bound
from cases.show.variables import PASSAGE_CURVES, PASSAGE_NUMBERS
from cases.show.words import with_key
from fpk.answer.certificate import Certificate
from fpk.answer.dynamics import Curve, Passage, Rates, Transient
from fpk.answer.method import Method
from fpk.answer.question import QUESTIONS, Question
from fpk.numeric.arrays import Array

Record = dict[str, Any]


def program_version() -> str:
    """Return the version of the installed distribution, else ``(not installed)``."""
    try:
        return version("vibro-fpk")
    except PackageNotFoundError:
        return "(not installed)"


def plain(record: Any) -> Record:
    """Return a dictionary, or the fields of a dataclass, with values as JSON has them.

    Arrays become lists, numbers that are not finite None, at any depth.
    """
    json_values: Record = to_jsonable_python(
        record, inf_nan_mode="null", fallback=lambda array: array.tolist()
    )
    return json_values


def answer_record(
    scene: Scene,
    method: Method,
    given: Record,
    answer: Curve | Rates | Transient | Passage,
    seconds: float,
    *,
    key: str = "",
) -> Record:
    """Return the record of a command that asks one method: the question, the answer, its checks.

    ``given`` has the question's entries, such as ``observable`` and ``points`` or ``limit``; the
    values of a curve or density are under ``key``, which rates and passages do not use. ``seconds``
    is the computing time. Numbers that are missing or not finite are None. ``averaging_notes`` say
    how large the averaging error is, or that it is unknown.
    """
    own: Record
    match answer:
        case Curve():
            own = {key: answer.values, "error": answer.errors}
        case Transient():
            own = {"times": answer.times, key: answer.values, "error": answer.errors}
        case Rates(values=rates):
            own = {"rates": rates.real, "frequencies": rates.imag, "errors": answer.errors}
        case Passage():
            own = passage_numbers(answer)
            if answer.starts is not None:
                own["starts"] = answer.starts
    if not isinstance(answer, Rates):
        own["error_kind"] = answer.error_kind
    units = answer_units(scene.units, given, key) if scene.units else None
    solver = answer.settings.get("solver", method.route.solver)  # of several inside of one method
    route = method.route
    head = {"scene": scene.name, "method": route.method, "solver": solver, "units": units}
    of = str(given.get("observable", given.get("limit", "rates")))
    asked = [(of, [method.route], not isinstance(answer, Curve))]
    tail = answer_tail(answer.certificate, answer.settings, seconds)
    notes = averaging_notes(scene.system, asked)
    return plain({**head, "solves": route.solves, **given, **own, **tail, "averaging_notes": notes})


def curves_by_key() -> dict[str, Question]:
    """Return the questions about the motion of a displacement, by ``Question.key``: "spectrum" …"""
    return {q.key: q for q in QUESTIONS.values() if q.of_displacement}


def answer_units(units: Units, given: Record, key: str) -> dict[str, str | list[str]]:
    """Return the units of the numbers of an answer by their keys in its ``answer_record``.

    ``given`` and ``key`` are arguments of that function: a passage has a ``limit``, rates have no
    ``key``. The ``points`` of a pair have a list of two units.
    """
    rate, times = units.quantity("rate"), {"times": units.time}
    if "limit" in given:
        variance = units.of((0, 0, 1), (0, 0, 1))
        limit = units.of(DIMENSIONS[given["limit"][:1]]) if given["limit"] else ""
        return {"limit": limit, "mean": units.time, "variance": variance, "rate": rate, **times}
    if not key:
        return {"rates": rate, "frequencies": rate}
    if key in (curves := curves_by_key()):
        points, values = map(units.of, curves[key].powers)
        return {"points": points, key: values}
    powers = [DIMENSIONS[name[0]] for name in given["observable"].split(",")]
    own = [units.of(power) for power in powers]
    return {
        "points": own if len(own) > 1 else own[0], key: units.of(*powers, inverse=True), **times
    }  # fmt: skip


def passage_numbers(answer: Passage) -> Record:
    """Return moments, failure rate, P(T > t), P(T ≤ t) and their errors, NaN if unknown, by key.

    Keys: ``times``, ``mean``, ``mean_error`` and so on by ``PASSAGE_NUMBERS``, ``PASSAGE_CURVES``.
    """
    record: Record = {}
    for key, (*_, read) in PASSAGE_NUMBERS.items():
        record[key], record[f"{key}_error"] = read(answer)
    record["times"] = answer.times
    for key, (_, read) in PASSAGE_CURVES.items():
        record[key], record[f"{key}_error"] = read(answer)
    return record


def point_list(points: tuple[Array, ...]) -> Array:
    """Return the points (points,) of one coordinate, or (points, 2) of two arrays ``points``."""
    return points[0] if len(points) == 1 else np.stack(points, axis=-1)


def answer_tail(
    certificate: Certificate, settings: Mapping[str, str | float | int], seconds: float
) -> Record:
    """Return ``certificate`` as a record, ``settings`` and ``seconds``, which end every answer."""
    return {"certificate": certificate.record, "settings": dict(settings), "seconds": seconds}


def columns_text(record: Record) -> str:
    """Return the record of a curve or density in columns: time if any, point, value, error."""
    (key,) = record.keys() & {"density", *(curves := curves_by_key())}
    names, units = record["observable"].split(","), (record.get("units") or {})
    if key in curves:
        names = [curves[key].axis or record["observable"]]
    own = units.get("points", [""] * len(names))
    points = zip(names, [own] if isinstance(own, str) else own, strict=True)
    head = "   ".join(name + in_brackets(unit) for name, unit in points)
    words = f"{head}   {key}{in_brackets(units.get(key, ''))}   {_kind(record)}"
    if "times" not in record:
        return "\n".join([f"# {words}", *_columns([], record, record[key], record["error"])])
    lines = [f"# time{in_brackets(units.get('times', ''))}   {words}"]
    for time, *rows in zip(record["times"], record[key], record["error"], strict=True):
        lines += _columns([time], record, *rows)
    return "\n".join(lines)


def _columns(
    first: list[float], record: Record, values: list[float], errors: list[float]
) -> Iterator[str]:
    """Yield a line for each point of ``record``: numbers ``first``, coordinates, value, error."""
    for point, value, error in zip(record["points"], values, errors, strict=True):
        yield _row([*first, *(point if isinstance(point, list) else [point]), value], error)


def passage_text(record: Record) -> str:
    """Return the record of a passage in lines: moments, failure rate, P(T > t) and P(T ≤ t)."""
    units = record.get("units") or {}
    unit = f" {units['limit']}" if units.get("limit") else ""
    limit = ", ".join(f"{part}{unit}" for part in record["limit"].split(","))
    lines = [f"# first passage of {limit} from {record['start']}   {_kind(record)}"]
    if sampled := record["settings"].get("sampled_by"):
        lines.append(f"# {sampled}")
    for key in ("mean", "variance", "rate"):
        unit = units.get(key, "")
        row = _row([record[key]], record[f"{key}_error"])
        lines.append(f"{key:8}  {row}{'  ' + unit if unit else ''}")
    time = f"# time{in_brackets(units.get('times', ''))}"
    for key, words in (("survival", "survival"), ("failure", "P(T <= t)")):
        if record["times"]:
            lines.append(f"{time}   {words}   {_kind(record)}")
            rows = zip(record["times"], record[key], record[f"{key}_error"], strict=True)
            lines += [_row([t, value], error) for t, value, error in rows]
    return "\n".join(lines)


def rates_text(record: Record) -> str:
    """Return an ``answer_record`` of relaxation rates as text: rate, frequency, error a line."""
    rows = zip(record["rates"], record["frequencies"], record["errors"], strict=True)
    lines = [_row([rate, frequency], error) for rate, frequency, error in rows]
    unit = in_brackets((record.get("units") or {}).get("rates", ""))
    return "\n".join([f"# rate{unit}   angular frequency{unit}   numerical error", *lines])


def equation_words(record: Record) -> str:
    """Return which equation was solved, by which theory, and with how many paths if it samples."""
    words = f"solves the {record['solves']} equation: {with_key(record['method'])}"
    settings = record["settings"]
    if paths := settings.get("paths", settings.get("trajectories")):
        words += f", {paths} paths; --tol or --seconds asks for more or fewer"
    return words


def _kind(record: Record) -> str:
    return "one standard error" if record["error_kind"] == "sampling" else "numerical error"


def _row(values: Iterable[float | None], error: float | None) -> str:
    """A line of numbers to 12 digits and an error rounded up; a dash for None."""
    words = ["-" if x is None else f"{x:.12g}" for x in values]
    return "  ".join([*words, "-" if error is None else bound(error)])
