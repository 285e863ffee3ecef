"""What a reader of an averaged number must know where no answer of the full system is beside it."""

from collections.abc import Iterable
from contextlib import suppress

from averaging.exact import compatibility
from averaging.linear_part import linear_part
from cases.scene.expect import ACCEPTABLE_L1
from fpk.clearance import stop_clearances
from fpk.errors import NotApplicable
from fpk.route import Route
from fpk.system import System


def incompatibility(system: System) -> str | None:
    """Return why the exact theory (7), (8) does not apply, None where it does."""
    try:
        compatibility(system)
    except NotApplicable as reason:
        return str(reason)
    return None


def averaging_note(system: System, routes: Iterable[Route], *, in_time: bool = False) -> str:
    """Return what is to be known of the averaging error of answers by ``routes``, else nothing.

    That is nothing with an answer of the full system among them, or where averaging is exact: under
    condition (8), if the motion is stationary (not ``in_time``) and no stop is left out. The note
    says to doubt the answer where the theory makes more than ``ACCEPTABLE_L1`` of error in an rms
    of the system without contacts, leaves out a stop within the rule of section 6.3, or, in time,
    where an energy swings by more within a period: by the damping ratio of itself.
    """
    routes = list(routes)
    theories = dict.fromkeys(r.method for r in routes if r.solves == "averaged")
    compatible = not in_time and incompatibility(system) is None
    alone = [t for t in theories if not compatible or (t == "integrable" and system.stops)]
    if not alone or any(r.solves == "full" for r in routes):
        return ""
    words, doubt = ["averaging error not known here"], False
    with suppress(NotApplicable):
        part = linear_part(system)
        ranges = [part.rms_ratio[theory] for theory in alone]
        doubt = max(abs(ratio - 1.0) for own in ranges for ratio in own) > ACCEPTABLE_L1
        doubt |= in_time and part.damping_ratio > ACCEPTABLE_L1
        own = [f"{t} gives {a:.3g} to {b:.3g}" for t, (a, b) in zip(alone, ranges, strict=True)]
        words += [
            f"without contacts {', '.join(own)} times the exact rms of each q and v (modal"
            f" temperatures differ by a factor of {part.temperatures:.2g}, damping ratios up to"
            f" {part.damping_ratio:.2g})"
        ]
    near = [s.ratio for s in system.fact(stop_clearances) if s.beyond_rule is False and s.ratio]
    if "integrable" in alone and near:
        words, doubt = [*words, f"a stop at {min(near):.2g} rms is left out"], True
    return "; ".join(words) + ": doubt it" * doubt


def averaging_notes(
    system: System, answers: Iterable[tuple[str, Iterable[Route], bool]]
) -> tuple[str, ...]:
    """Return the notes on ``answers``: what of, by which routes, in time; the same words once."""
    subjects: dict[str, list[str]] = {}
    for of, routes, in_time in answers:
        subjects.setdefault(averaging_note(system, routes, in_time=in_time), []).append(of)
    return tuple(f"{', '.join(own)}: {note}" for note, own in subjects.items() if note)
