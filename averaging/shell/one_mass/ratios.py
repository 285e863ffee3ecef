"""Energy shells of a system with one contact mass, compiled: the integrals of (25), (28), any n.

One contact mass leaves integrals over a line, ∫ v^a (1, v, a/v) dr with v = 1 − V_red/H and
a = n − 3/2, along the two rays from rest. Up to the first stop they are powers of cosines in
closed form. Beyond, x = X sin²φ with X the distance to the turning point removes the root there and
the half-integer powers of Hertz contact, as in ``averaging.shell.panel``, of which this is the
compiled twin for one mass. For many masses v^a has died out long before the turning point, and
x = x₀ s² goes as far as that: the same few points serve any number of masses.
"""

from functools import lru_cache
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from averaging.shell.one_mass.panels import RULES, Rules, Work, add_panels, gauss_rules
from averaging.shell.one_mass.rays import Rays, inner, turning_points
from averaging.shell.reduced import ReducedPotential
from averaging.shell.sums import ROOT_ROUND_OFF, ROUND_OFF, TARGET
from fpk.compiled_laws import compiled_laws, law_files
from fpk.compiling import ROOT, cached_njit, checksum

Array = NDArray[np.float64]

SOURCES = (
    "averaging/shell/one_mass/panels.py",
    "averaging/shell/one_mass/ratios.py",
    "averaging/shell/one_mass/rays.py",
    "averaging/shell/sums.py",
    "fpk/quadrature.py",
)
"""Files that the ratios are compiled from, beside the laws."""
MANY = 5
"""Masses from which the first rule would be refused, as v^a is narrow."""
ROUNDED = 0.5 * np.finfo(float).eps
"""For n = 1 the part beyond a stop is ~ √(H − V), V at the stop: a rounding of H is relative to T
ε √(H/(H − V)), of either sign, half of it to be expected."""
DIED_OUT = 1e-18
"""Share of its value at the stop below which v^a is left out."""
LEAST_LEFT = 0.005
"""Share of v that is left by then for the cut to be worth a second root: from n = 10 on."""


class OneMassShell:
    """The ratios of ``shell_ratios`` for one contact mass, compiled for the laws that act."""

    def __init__(self, potential: ReducedPotential) -> None:
        """Sort the stops along the rays, of which there is one where V is even."""
        stops = sorted(potential.stops, key=attrgetter("clearance"))
        names = tuple(sorted({stop.law for stop in stops}))
        sides = ("right",) if potential.mirror else ("right", "left")
        rays = [[stop for stop in stops if stop.side == side] for side in sides]
        along = [stop for ray in rays for stop in ray]
        self.rays = Rays(
            np.cumsum([0, *map(len, rays)]),
            np.array([s.clearance for s in along], dtype=float),
            np.array([s.stiffness for s in along], dtype=float),
            np.array([s.power for s in along], dtype=float),
            np.array([names.index(s.law) for s in along], dtype=np.int64),
            float(potential.L[0, 0]),
        )
        self.n = potential.n
        self.ratios = compiled_ratios(names, potential.n == 1)

    def __call__(self, energy: Array) -> Array:
        """The rows of ``ShellRatios``, (5, energies)."""
        found = np.empty((5, energy.size))
        self.ratios(energy, self.rays, self.n, gauss_rules(), found)
        return found


@lru_cache
def compiled_ratios(names: tuple[str, ...], single: bool) -> Any:
    """Return the ratios for the laws ``names``; n = 1 (``single``) needs their slopes, too."""
    sources = checksum([*law_files(names), *(ROOT / name for name in SOURCES)])
    U: Any = compiled_laws(names, "energy")
    g: Any = compiled_laws(names, "force")
    bend: Any = compiled_laws(names, "slope" if single else "force")

    @cached_njit()
    def ratios(energy: Array, rays: Rays, n: int, rules: Rules, found: Array) -> int:
        """Fill the rows of ``found``, (5, energies); return the checksum of the sources."""
        free_states, free_volume = _cosines(2 * n - 2), _cosines(2 * n)
        share = DIED_OUT ** (1.0 / (n - 1.5)) if n > 2 else 0.0
        share = share if share > LEAST_LEFT else 0.0
        w = np.empty((7, RULES[-1]))
        work = Work(w[0], w[1], w[2], w[3], w[4], w[5], w[6])
        free, sums, finer = np.empty(3), np.empty(3), np.empty(3)
        X, top = np.empty(rays.clearance.size), np.empty(rays.clearance.size)
        count = rays.first.size - 1
        floor = ROOT_ROUND_OFF if single else ROUND_OFF
        least = np.inf
        for k in range(count):
            if rays.first[k + 1] > rays.first[k]:
                least = min(least, rays.clearance[rays.first[k]] / rays.reach)
        for i in range(energy.size):
            H = energy[i]
            if 0.5 * least * least >= H:
                found[0, i] = found[1, i] = 1.0
                found[2, i], found[3, i], found[4, i] = n - 1.0, 0.0, 0.0
                continue
            least_height = turning_points(H, rays, share, X, top, U, g)
            rounding = floor
            if single:
                rounding += ROUNDED * np.sqrt(H / least_height)
            free[0] = free[1] = free[2] = 0.0
            for k in range(count):
                first = np.inf
                if rays.first[k + 1] > rays.first[k]:
                    first = rays.clearance[rays.first[k]] / rays.reach
                _free_part(H, first, n, free)
            for part in range(3):
                sums[part] = finer[part] = free[part]
            # Two rules at once, then one after another; of many masses the first is too coarse.
            begin = 0 if n < MANY else 1
            rule, stop = begin, begin + 2
            split = rules.first[begin + 1] - rules.first[begin]
            error, slope_error = np.inf, np.inf
            while max(error, slope_error) > TARGET and stop < rules.first.size:
                add_panels(
                    H, rays, X, top, n, rules, rule, stop, split, work, sums, finer, U, g, bend,
                    single,
                )  # fmt: skip
                error, slope_error = _disagreement(sums, finer)
                rule, stop, split = stop, stop + 1, 0
                if max(error, slope_error) > TARGET and stop < rules.first.size:
                    for part in range(3):
                        sums[part], finer[part] = finer[part], free[part]
            found[0, i] = finer[0] / (count * free_states)
            found[1, i] = finer[1] / (count * free_volume)
            found[2, i] = finer[2] / finer[0]
            found[3, i], found[4, i] = error + rounding, slope_error + error + rounding
        return sources

    return ratios


@inner
def _disagreement(coarse: Array, fine: Array) -> tuple[float, float]:
    """Relative differences of two sums, T and Φ, and of T', relative to T at least.

    Infinite where a sum is no number.
    """
    states = abs(coarse[0] - fine[0]) / fine[0]
    volume = abs(coarse[1] - fine[1]) / fine[1]
    change = abs(coarse[2] - fine[2]) / max(abs(fine[2]), fine[0])
    if not np.isfinite(states + volume + change):
        return np.inf, np.inf
    return max(states, volume), change


@inner
def _cosines(m: int) -> float:
    """√2 ∫cos^m θ dθ from 0 to π/2, m even."""
    integral: float = np.sqrt(2.0) * 0.5 * np.pi
    for k in range(2, m + 1, 2):
        integral *= (k - 1) / k
    return integral


@inner
def _free_part(H: float, end: float, n: int, out: Array) -> None:
    """Add the three integrals up to the first stop, where V = ½ r²; r = √(2H) sin θ."""
    sine = min(end / np.sqrt(2.0 * H), 1.0)
    cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
    # ∫cos^m from that of m − 2, (cos^(m−1) sin + (m − 1) ∫cos^(m−2))/m: sums of positive terms.
    power, below, integral = cosine * sine, 0.0, np.arctan2(sine, cosine)
    for m in range(2, 2 * n, 2):
        below = integral
        integral = (power + (m - 1) * integral) / m
        power *= cosine * cosine
    out[0] += np.sqrt(2.0) * integral
    out[1] += np.sqrt(2.0) * (power + (2 * n - 1) * integral) / (2 * n)
    out[2] += np.sqrt(2.0) * (n - 1.5) * below
