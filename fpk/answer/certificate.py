"""Certificates: numbers measured on an answer, and the only place that compares them to limits."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Self, TypeVar

import numpy as np

from fpk.numeric.arrays import ROUND_OFF
from fpk.numeric.errors import require

Default = TypeVar("Default")

NEGATIVE = -1e-14
"""Lowest p / max p that counts as round-off of 0; −``NEGATIVE`` is the round-off of ∫p."""
DISTANCE_FACTOR = 3.0
"""Stated error over the distance to a comparison solution: elements of a higher degree, or coarser
quadrature. Integrals across kinks (1 − H)^1.5 and (1 − H)^2.5 anywhere in panels were within it in
97 % of cases. In 3,000 random processes of two energies the true error was 2.1 times the distance
once, and at most 1.4 times otherwise (test_fpk_plane_random.py)."""
MISSED = "the estimated error"
"""First words of the message that an estimated error exceeds the tolerance."""


def tolerance(tol: float | None, default: Default) -> float | Default:
    """Return ``tol``, or ``default`` if it is None; raise ``InvalidInput`` unless ``tol`` > 0."""
    if tol is None:
        return default
    require(tol > 0.0, "tol", tol, "must be > 0")
    return tol


@dataclass(frozen=True)
class Measured:
    """Numbers measured on an answer; None if a number does not apply.

    ``l1_error`` estimates ∫|p − p_exact|, all errors included; for answers other than densities it
    is the error compared with the tolerance. ``mass_defect`` is |∫p − 1| over the support, without
    tails; ``minimum`` is min p / max p; ``residual`` is the residual of the equation relative to
    its largest term (for sampling: the largest |z| of the moment identities, or NaN); ``tail_mass``
    is a bound (for sampling: the share) of the mass outside the support; ``net_flux`` is the
    largest probability flux through an element, relative to its one-way parts; ``absolute_error``
    is the largest stated error of p over max p, within which p may be negative; ``failures`` are
    further failed checks, in words.
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
        """Return a copy with ``words``, one message per failed check, appended to ``failures``."""
        return replace(self, failures=(*self.failures, *words))


@dataclass(frozen=True)
class Certificate(Measured):
    """Measured numbers and the checks that failed; made by ``certify`` only.

    ``Measured`` explains the numbers. ``failures`` are the failed checks in words; the answer is
    certified if there are none. ``missed`` is the estimated error if it exceeds the tolerance, else
    None. ::

        certificate = fpk.solve(system, ["q2"], methods=["integrable"])["q2"].certificate
        certificate.certified, certificate.failures, certificate.mass_defect
    """

    missed: float | None = None

    @property
    def certified(self) -> bool:
        """Whether every check passed."""
        return not self.failures

    @property
    def record(self) -> dict[str, Any]:
        """``certified`` and all fields but ``l1_error`` and ``absolute_error``, by their names."""
        own = {k: x for k, x in vars(self).items() if k not in ("l1_error", "absolute_error")}
        return own | {"certified": self.certified}

    @property
    def besides(self) -> tuple[str, ...]:
        """The ``failures`` without the message that the estimated error exceeds the tolerance."""
        return tuple(words for words in self.failures if not words.startswith(MISSED))


def largest_measured(values: Iterable[float | None]) -> float | None:
    """Return the largest of ``values`` except None; NaN if any is NaN, None if all are None."""
    given = [x for x in values if x is not None]
    return float(np.max(given)) if given else None


def fail_nan(answer: Any) -> None:
    """Replace ``answer.certificate`` by a copy with another failure if ``answer.values`` or
    ``answer.errors`` contain NaN."""
    if missing := int(np.isnan(answer.values).sum() + np.isnan(answer.errors).sum()):
        words = f"{missing} of the values and errors are not numbers"
        object.__setattr__(answer, "certificate", answer.certificate.with_failures(words))


def certify(measured: Measured, *, tol: float, sampled: bool = False) -> Certificate:
    """Return the certificate of an answer, by comparing ``measured`` numbers to their limits.

    ``measured.failures`` stay. Further failures are p below 0 by more than its stated error, an L1
    error above ``tol``, an infinite tail, a mass defect above the L1 error, and a residual or net
    flux not below ``ROUND_OFF``. ``tol`` is infinite if there is no tolerance. Mass and residual of
    a ``sampled`` answer are not checked here: its residual is a |z|. A number that is NaN fails its
    check; a number that is None is not checked. Raises nothing.
    """
    m, failures = measured, list(measured.failures)
    if m.minimum is not None and not m.minimum >= NEGATIVE - m.absolute_error:
        failures.append(f"the density falls to {m.minimum:.2g} of its maximum")
    missed = None if m.l1_error <= tol else m.l1_error
    if missed is not None:
        failures.append(f"{MISSED} {m.l1_error:.2g} exceeds the tolerance {tol:.2g}")
    if m.tail_mass is not None and not m.tail_mass < float("inf"):
        failures.append("the density does not fall off at the end of the mesh")
    # ∫|p − p_exact| is at least |∫p − ∫p_exact|.
    off = None if sampled else m.mass_defect
    if off is not None and not off <= m.l1_error - NEGATIVE:
        words = f"the mass is off by {off:.2g}, more than the stated error {m.l1_error:.2g}"
        failures.append(words)
    if not sampled and m.residual is not None and not m.residual < ROUND_OFF:
        failures.append(f"the residual of the equation is {m.residual:.2g}")
    if m.net_flux is not None and not m.net_flux < ROUND_OFF:
        failures.append(f"the net flux is {m.net_flux:.2g} of the one-way flux")
    return Certificate(**{**vars(m), "failures": tuple(failures), "missed": missed})
