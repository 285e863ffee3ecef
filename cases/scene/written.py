"""Numbers and their errors as text; errors and bounds are rounded up."""

from math import ceil, floor, isfinite, log10
from typing import Any

DIGITS = 7
"""Largest number of significant digits of a number with its error in brackets."""

SMALL = 1e-3
"""A number x with |x| <= error < ``SMALL`` is written ``0(error)``."""

SCHEMA = 2
"""Version of the records of JSON: 2 has this number, ``quantities``, and curves in one shape."""

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

TIME_UNITS = (
    (3.156e7, "years"), (86400.0, "days"), (3600.0, "h"), (60.0, "min"), (1.0, "s"), (1e-3, "ms"),
)  # fmt: skip
"""Units of time in seconds, with their names."""

NOTE = (
    "(3): error of the last digits, numerical or one standard error of sampling; "
    "without it the error is below the last digit."
)


def number(value: Any, digits: int = 3) -> str:
    """Return ``value`` as text: a float as ``1.23 × 10⁻⁵``, to ``digits`` significant digits.

    If 0, or from 1e-3 to below 1e5, it is plain, with one digit more. The entries of a list or
    tuple are joined by commas; None is a dash; anything else is ``str(value)``.
    """
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


def round_up(value: float, last: int) -> int:
    """Return the least integer k with k · 10**``last`` >= ``value`` · (1 − 1e-12); ``value`` >= 0.

    The 1e-12 is round-off, which must not make k larger.
    """
    return ceil(value / 10.0**last * (1.0 - 1e-12))


def bound(error: float | None, digits: int = 2) -> str:
    """Return an error rounded up to ``digits`` digits, as ``1.3e-03``; "0", "inf", None: a dash."""
    if error is None:
        return "–"
    if error == 0.0 or not isfinite(error):
        return f"{error:g}"
    last = floor(log10(error)) - digits + 1
    return f"{round_up(error, last) * 10.0**last:.{digits - 1}e}"


def percent(share: float, *, up: bool = False) -> str:
    """Return ``100 * share`` to two digits, as ``12 %``; 0 if negative. ``up``: rounded up."""
    value = 100.0 * share
    if value <= 0.0:
        return "0 %"
    last = floor(log10(value)) - 1
    digits = round_up(value, last) if up else round(value / 10.0**last)
    return f"{digits * 10.0**last:.2g} %" if value < 99.5 else f"{digits * 10.0**last:.0f} %"


def up(error: float | None) -> str:
    """Return ``bound`` of an error in the form of ``number``: ``0.0013`` for 0.00121."""
    return number(None if error is None else float(bound(error)), 2)


def with_error(value: float | None, error: float | None) -> str:
    """Return ``value`` with its ``error`` in brackets, in units of the last digits: ``0.4123(5)``.

    No brackets if the error is below half a unit of the last of ``DIGITS`` digits; ``0(2e-10)`` for
    a number within its error of zero, the error below ``SMALL``; a dash if either is None.
    """
    if value is None or error is None:
        return "–"
    if error == 0.0:
        return f"{value:.{DIGITS}g}"
    if not isfinite(error):
        return f"{value:.{DIGITS}g}({error:g})"
    if abs(value) <= error < SMALL:
        return f"0({bound(error, 1)})"
    magnitude = floor(log10(max(abs(value), error)))
    last = magnitude - DIGITS + 1
    shift = magnitude if not -4 <= magnitude < 6 else 0
    suffix = f"e{shift:+03d}" if shift else ""
    bracket = ""
    if error >= 0.5 * 10.0**last:
        # Two digits of an error that begins with 1.
        leading = floor(log10(error))
        last = leading - (1 if error < 2.0 * 10.0**leading else 0)
        count, decimals = round_up(error, last), shift - last
        bracket = f"({count})" if decimals >= 0 else f"({count * 10**-decimals})"
    decimals = max(shift - last, 0)
    return f"{value / 10.0**shift:z.{decimals}f}{bracket}{suffix}"


def duration(seconds: float, digits: int = 3) -> str:
    """Return ``seconds`` to ``digits`` digits in a suitable unit: ``1.5 min``, ``2 days``."""
    size, unit = next((u for u in TIME_UNITS if seconds >= u[0]), TIME_UNITS[-1])
    value = seconds / size
    text = f"{float(f'{value:.{digits}g}'):g}" if value < 1e4 else f"{value:.1e}"
    return f"{text} {unit.removesuffix('s') if text == '1' and len(unit) > 2 else unit}"
