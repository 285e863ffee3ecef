"""Modal energies far out: whether damping that depends on them keeps them from growing for ever."""

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from averaging.modal.state_damping import NEGLIGIBLE, StateDamping

Array = NDArray[np.float64]


def growth_reason(damping: StateDamping) -> str | None:
    """Return which modal energies grow for ever, or None where the leading terms forbid it.

    Far out dH_m = −γ_m H_m dt, and the leading coefficients of the rates γ_m decide: noise moves
    the energies by less and less there. One energy needs a positive one. Two energies with leading
    parts g_m of one degree approach rays: s = H_1/(H_1 + H_2) obeys s' ~ s (1 − s)(g_2 − g_1), and
    on each ray that attracts the damping must be positive; where it is not, the energies leave for
    infinity with a positive probability, and no stationary density exists. A ray on which the
    leading part vanishes is judged by the rest of the polynomial where that is possible. Groups of
    three modes and more are not judged.
    """
    for group in damping.groups():
        rates = damping.of_group(group)
        if len(group) == 1 and rates.along(0)[-1] <= 0.0:
            return (
                f"mode {group[0] + 1}: its damping is not positive at high energy, so its energy "
                "grows for ever"
            )
        if len(group) == 2 and (share := _growing_ray(rates)) is not None:
            first, second = (f"H{m + 1}" for m in group)
            return (
                f"the damping feeds energy in at high energy, where {first} : {second} approaches "
                f"{share:.3g} : {1.0 - share:.3g}, so they grow for ever"
            )
    return None


def _growing_ray(rates: StateDamping) -> float | None:
    """The share of H_1 on an attracting ray of two energies where the damping is negative."""
    g = _leading_parts(rates)
    size = max(float(np.max(np.abs(part.coef))) for part in g)
    difference = g[1] - g[0]
    if np.max(np.abs(difference.coef)) <= NEGLIGIBLE * size:  # every ray stays what it is
        ends = [0.0, *_roots(g[0]), 1.0]
        middles = 0.5 * (np.array(ends[1:]) + ends[:-1])
        return next((float(s) for s in (*middles, 0.0, 1.0) if g[0](s) < 0.0), None)
    rays = [0.0, *_roots(difference), 1.0]
    drift = difference(0.5 * (np.array(rays[1:]) + rays[:-1]))
    for k, s in enumerate(rays):
        attracting = (k == 0 or drift[k - 1] > 0.0) and (k == drift.size or drift[k] < 0.0)
        damping = float(g[int(s == 0.0)](s))
        if s in (0.0, 1.0) and abs(damping) <= NEGLIGIBLE * size:
            damping = float(rates.along(int(s == 0.0))[-1])
        if attracting and damping < -NEGLIGIBLE * (size if 0.0 < s < 1.0 else 0.0):
            return s
    return None


def _leading_parts(rates: StateDamping) -> tuple[Polynomial, Polynomial]:
    """The parts of γ_1 and γ_2 of the highest degree that occurs in one of them, by s."""
    acting = [part for part in rates.parts if np.any(np.einsum("rmm->rm", part.coefficients))]
    leading = acting[-1]
    degree = leading.factors.shape[1]
    s, rest = Polynomial([0.0, 1.0]), Polynomial([1.0, -1.0])
    parts = [Polynomial([0.0]), Polynomial([0.0])]
    for factors, coefficients in zip(leading.factors, leading.coefficients, strict=True):
        power = int(np.sum(factors == 0))
        for m in (0, 1):
            parts[m] = parts[m] + float(coefficients[m, m]) * s**power * rest ** (degree - power)
    return parts[0], parts[1]


def _roots(polynomial: Polynomial) -> list[float]:
    """The real roots between 0 and 1, ascending."""
    roots = polynomial.trim(NEGLIGIBLE * float(np.max(np.abs(polynomial.coef)))).roots()
    real = roots.real[np.abs(roots.imag) <= 1e-9]
    return sorted(float(s) for s in real if 0.0 < s < 1.0)
