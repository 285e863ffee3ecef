"""Figures of Monte Carlo measured before this program had any code, and those measured here."""

from collections.abc import Sequence

Line = dict
Range = tuple[float, float] | None
LANGEVIN = ("ALIGN", "ShOULD", "QUICSORT")
GENERAL = ("Euler", "Heun", "ShARK", "SRA1")
# words, peer, beginnings of schemes, ns a step, step, ns per unit time, why if off by more than two
ANCHORS: tuple[tuple[str, str, tuple[str, ...], Range, float | None, Range, str], ...] = (
    ("diffrax", "diffrax", GENERAL, (55, 86), None, None, ""),
    ("diffrax, Langevin", "diffrax", LANGEVIN, (270, 520), None, None, "JAX's rbg generator here"),
    ("torchsde", "torchsde", ("",), (76, 215), None, None, "perhaps other schemes"),
    ("jitcsde", "jitcsde", ("SRA1, 2 copies",), (860, 6500), None, None, "perhaps more copies"),
    ("sdeint", "sdeint", ("stratHeun, dense G, 2",), (3500, 14600), None, None,
     "two copies in one system halve Python's time"),
    ("NumPy, vectorised", "NumPy", ("",), (23, 34), None, None, ""),
    ("BAOAB: C, numba", "vibro-fpk", ("baoab",), (1.1, 1.95), 0.07, (16, 28),
     "then SIMD by hand; another processor"),
    ("exact linear flow, modified kick", "vibro-fpk", ("exact_flow",), (2.1, 2.1), 0.23, (9, 9),
     ""),
)  # fmt: skip
FACTOR = 2.0


def anchored(schemes: Sequence[Line]) -> list[list[str]]:
    """Return rows: what, ns a step, step and ns per unit time, then and now, off by, why."""
    rows = []
    for words, peer, begins, ns, step, ns_time, why in ANCHORS:
        here = [s for s in schemes if s["peer"] == peer and s["scheme"].startswith(begins)]
        now = _range(here, "ns")
        steps, times = _range(here, "allowed"), _range(here, "ns_time")
        off = max((_off(a, b) for a, b in ((ns, now), (ns_time, times)) if a and b), default=None)
        if step and steps:
            off = max(off or 1.0, _off((step, step), steps))
        verdict = "not measured" if off is None else f"{off:.2g}"
        rows.append(
            [words, _words(ns), _words(now), _words((step, step) if step else None),
             _words(steps) if step else "–", _words(ns_time), _words(times) if ns_time else "–",
             verdict, why if off and off > FACTOR else ""]
        )  # fmt: skip
    return rows


def _range(lines: Sequence[Line], key: str) -> Range:
    found = [line[key] for line in lines if line[key] is not None]
    return (min(found), max(found)) if found else None


def _off(then: tuple[float, float], now: tuple[float, float]) -> float:
    """Return the factor between the nearest ends of two ranges, 1 where they meet."""
    return max(1.0, now[0] / then[1], then[0] / now[1])


def _words(found: Range) -> str:
    if found is None:
        return "–"
    low, high = (f"{x:.3g}" for x in found)
    return low if low == high else f"{low} to {high}"
