"""Which of a package's measurements speaks for it."""

from collections.abc import Sequence

Line = dict


def telling(lines: Sequence[Line]) -> list[Line]:
    """Return the lines of kind ``scheme`` whose time to the wanted error may be taken.

    Of a scheme that was run at several steps above the allowed one only the finest is taken, from
    which the order is trusted least far; a step whose own bias is small enough always.
    """
    found: list[Line] = []
    with_step = [s for s in lines if s["kind"] == "scheme" and s["allowed"] is not None]
    for peer, scheme in dict.fromkeys((s["peer"], s["scheme"]) for s in with_step):
        same = [s for s in with_step if (s["peer"], s["scheme"]) == (peer, scheme)]
        found += [s for s in same if s["allowed"] == s["step"]]
        found += sorted((s for s in same if s["allowed"] < s["step"]), key=lambda s: s["step"])[:1]
    return found


def best(lines: Sequence[Line], peers: Sequence[str]) -> Line | None:
    """Return the scheme of ``peers`` with the least ns per path and unit time."""
    fit = [s for s in telling(lines) if s["peer"] in peers]
    return min(fit, key=lambda line: line["ns_time"], default=None)
