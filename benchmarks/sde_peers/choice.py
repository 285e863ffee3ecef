"""Which of a package's measurements speaks for it."""

from collections.abc import Sequence

Line = dict
ALLOWED = {"ns_time": "allowed", "ns_time_square": "allowed_square"}


def telling(lines: Sequence[Line], key: str = "ns_time") -> list[Line]:
    """Return the lines of kind ``scheme`` whose ``key`` may be taken.

    Of a scheme that was run at several steps above the allowed one only the finest is taken, from
    which the order is trusted least far; a step whose own bias is small enough always.
    """
    step, found = ALLOWED[key], []
    with_step = [s for s in lines if s["kind"] == "scheme" and s[step] is not None]
    for peer, scheme in dict.fromkeys((s["peer"], s["scheme"]) for s in with_step):
        same = [s for s in with_step if (s["peer"], s["scheme"]) == (peer, scheme)]
        found += [s for s in same if s[step] == s["step"]]
        found += sorted((s for s in same if s[step] < s["step"]), key=lambda s: s["step"])[:1]
    return found


def best(lines: Sequence[Line], peers: Sequence[str], key: str = "ns_time") -> Line | None:
    """Return the scheme of ``peers`` with the least ns per path and unit time."""
    fit = [s for s in telling(lines, key) if s["peer"] in peers]
    return min(fit, key=lambda line: line[key], default=None)
