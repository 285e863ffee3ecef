"""Times in words."""

UNITS = (
    (3.156e7, "years"), (86400.0, "days"), (3600.0, "h"), (60.0, "min"), (1.0, "s"), (1e-3, "ms"),
)  # fmt: skip
"""Units of time in seconds, with their names."""


def duration(seconds: float, digits: int = 3) -> str:
    """Return a time with a unit that suits it: ``1.5 min``, ``2 days``, ``3.2e+06 years``."""
    size, unit = next((u for u in UNITS if seconds >= u[0]), UNITS[-1])
    value = seconds / size
    text = f"{float(f'{value:.{digits}g}'):g}" if value < 1e4 else f"{value:.1e}"
    return f"{text} {unit.removesuffix('s') if text == '1' and len(unit) > 2 else unit}"
