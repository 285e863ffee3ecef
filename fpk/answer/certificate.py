"""Certificates of answers: the measured numbers, their limits, and the one place that compares."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Self, TypeVar

import numpy as np

from fpk.numeric.arrays import ROUND_OFF
from fpk.numeric.errors import InvalidInput

Default = TypeVar("Default")

NEGATIVE = -1e-14
"""Smallest p / max p that counts as round-off; its size is the round-off of a mass."""
MISSED = "the estimated error"
"""First words of the failure that an estimated error exceeds the tolerance."""


def tolerance(tol: float | None, default: Default) -> float | Default:
    """Return the tolerance asked for, or else the default; ``InvalidInput`` unless it is > 0."""
    if tol is None:
        return default
    if not tol > 0.0:
        raise InvalidInput("tol", tol, "must be > 0")
    return tol


@dataclass(frozen=True)
class Measured:
    """Numbers measured on an answer, None where it has no such thing.

    ``l1_error`` estimates ∫|p − p_exact| in full. ``mass_defect`` is |∫p − 1| over the support,
    before any tail; ``minimum`` the smallest value of p over its largest; ``residual`` how far p is
    from solving its equation, relative to the terms that cancel (for sampling: the largest |z| of
    the moment identities, or NaN); ``tail_mass`` a bound (for sampling: the share) of the mass
    outside the support; ``net_flux`` the largest probability flux through an element relative to
    its one-way parts; ``absolute_error`` the stated error of p anywhere, in units of its largest
    value, to which its sign is known; ``failures`` what else does not hold, in words.
    """

    l1_error: float
    mass_defect: float | None
    minimum: float | None
    residual: float | None
    tail_mass: float | None
    net_flux: float | None = None
    failures: tuple[str, ...] = ()
    absolute_error: float = 0.0

    def with_failures(self, *words: str) -> Self:
        """Return the same with more that does not hold."""
        return replace(self, failures=(*self.failures, *words))


@dataclass(frozen=True)
class Certificate(Measured):
    """Checks that an answer passed or failed; nothing was mended to make them pass.

    ``Measured`` explains the numbers. ``failures`` says in words what does not hold; the answer
    is certified when it is empty. ``missed`` is the estimated error where it exceeds the tolerance,
    else None. Made by ``certify`` only. ::

        certificate = fpk.solve(system, ["q2"], methods=["integrable"])["q2"].certificate
        certificate.certified, certificate.failures, certificate.mass_defect
    """

    missed: float | None = None

    @property
    def certified(self) -> bool:
        """Whether every check holds."""
        return not self.failures

    @property
    def record(self) -> dict[str, Any]:
        """The checks and their numbers by name, but for the errors, which stand in the answer."""
        own = {k: x for k, x in vars(self).items() if k not in ("l1_error", "absolute_error")}
        return own | {"certified": self.certified}

    @property
    def besides(self) -> tuple[str, ...]:
        """The failures but that the estimated error exceeds the tolerance."""
        return tuple(words for words in self.failures if not words.startswith(MISSED))


def largest_measured(values: Iterable[float | None]) -> float | None:
    """Return the largest of what was measured, NaN if one is; None where nothing was."""
    given = [x for x in values if x is not None]
    return float(np.max(given)) if given else None


class WithoutNaN:
    """An answer that is not certified with a NaN among its ``values`` and ``errors``."""

    def __post_init__(self: Any) -> None:
        """Add the failure to the certificate."""
        if missing := int(np.isnan(self.values).sum() + np.isnan(self.errors).sum()):
            words = f"{missing} of the values and errors are not numbers"
            object.__setattr__(self, "certificate", self.certificate.with_failures(words))


def certify(measured: Measured, *, tol: float, sampled: bool = False) -> Certificate:
    """Return the certificate of an answer: the only place where one is made.

    ``tol`` is the tolerance of the L1 error, infinite where none was asked for. The residual of a
    ``sampled`` answer is a |z|, which the simulation judges. A NaN fails every comparison.
    """
    m, failures = measured, list(measured.failures)
    if m.minimum is not None and not m.minimum >= NEGATIVE - m.absolute_error:
        failures.append(f"the density falls to {m.minimum:.2g} of its maximum")
    missed = None if m.l1_error <= tol else m.l1_error
    if missed is not None:
        failures.append(f"{MISSED} {m.l1_error:.2g} exceeds the tolerance {tol:.2g}")
    if m.tail_mass is not None and not m.tail_mass < float("inf"):
        failures.append("the density does not fall off at the end of the mesh")
    # ∫|p − p_exact| cannot be less than |∫p − ∫p_exact|.
    off = None if sampled else m.mass_defect
    if off is not None and not off <= m.l1_error - NEGATIVE:
        failures.append(
            f"the mass is off by {off:.2g}, more than the stated error {m.l1_error:.2g}"
        )
    if not sampled and m.residual is not None and not m.residual < ROUND_OFF:
        failures.append(f"the residual of the equation is {m.residual:.2g}")
    if m.net_flux is not None and not m.net_flux < ROUND_OFF:
        failures.append(f"the net flux is {m.net_flux:.2g} of the one-way flux")
    return Certificate(**{**vars(m), "failures": tuple(failures), "missed": missed})
