"""Integrals over the energy shell along rays from the equilibrium, exact at its singular ends.

Along a ray y = r e of whitened coordinates V rises strictly, so the shell is 0 <= r <= R. The ray
is cut where a stop is first touched. Up to the first cut the integrals are incomplete beta
functions. In every later panel the substitution x = X sin²φ, with X the distance to the turning
point that the panel's own smooth potential would have, removes both the root at the turning point
and the half-integer powers of Hertz contact, and stays smooth when the true turning point lies
just beyond the panel.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import beta, betainc

from averaging.shell.reduced import ReducedPotential
from fpk.quadrature import gauss_legendre

Array = NDArray[np.float64]

NEWTON_STEPS = 60
"""Far more than the logarithmic Newton iteration takes (about five): it converges monotonically."""


def shell_ray_integrals(
    potential: ReducedPotential, energy: Array, directions: Array, *, rules: Sequence[int]
) -> Array:
    """Return ∫ v^a r^(c−1) (1, v, w) dr along rays, v = 1 − V/H, lengths in units of √H.

    ``energy`` (rays,) and unit ``directions`` (rays, c); a = n − c/2 − 1. The three integrals
    belong to T, to the phase volume and to H T'. For a > 0, w = a/v, the derivative under the
    integral; otherwise that diverges and w = a + 1 + V ((c−1)/(r V_r) − V_rr/V_r²), from
    differentiating with V as the variable. ``rules`` are numbers of Gauss points per panel, each
    of which gives a result of its own. Shape (rules, rays, 3).
    """
    c = potential.count
    exponent = potential.n - 0.5 * c - 1.0
    first, panels = _cut(potential, energy, directions)
    total = np.empty((len(rules), energy.size, 3))
    total[:] = _free_panel(energy, first, exponent, c)
    for rays, panel, level, end_level, length in panels:
        total[:, rays] += panel.integrals(
            energy[rays], level, end_level, length, exponent=exponent, rules=rules
        )
    return total


def shell_ray_moments(
    potential: ReducedPotential,
    energy: Array,
    directions: Array,
    orders: Sequence[tuple[int, int]],
    *,
    rules: Sequence[int],
) -> Array:
    """Return ∫ v^(a+j) r^(k+c−1) dr along rays for every (k, j) of ``orders``.

    v = 1 − V/H and a as in ``shell_ray_integrals``, lengths in units of √H. Shape
    (rules, rays, orders).
    """
    c = potential.count
    exponent = potential.n - 0.5 * c - 1.0
    first, panels = _cut(potential, energy, directions)
    total = np.empty((len(rules), energy.size, len(orders)))
    share = _free_share(energy, first)
    for column, (k, j) in enumerate(orders):
        half = 0.5 * (c + k)
        total[..., column] = 2.0 ** (half - 1.0) * _beta_to(share, half, exponent + j + 1.0)
    for rays, panel, level, end_level, length in panels:
        total[:, rays] += panel.moments(
            energy[rays], level, end_level, length, exponent=exponent, orders=orders, rules=rules
        )
    return total


def _cut(
    potential: ReducedPotential, energy: Array, directions: Array
) -> tuple[Array, Iterator[tuple[NDArray[np.intp], "_Panel", Array, Array, Array]]]:
    """Where rays first touch a stop, (rays,), and the panels beyond.

    Each panel comes with the rays that reach it, V at its start and end (∞ for none) and length.
    """
    reach = np.maximum(directions @ potential.rows.T, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        touch = np.where(reach > 0, potential.clearance / reach, np.inf)
    # Columns that no ray reaches are dropped: a stop that cannot be touched costs nothing.
    cuts = np.sort(touch, axis=1)
    cuts = cuts[:, np.isfinite(cuts).any(axis=0)]
    edges = np.concatenate([cuts, np.full((energy.size, 1), np.inf)], axis=1)

    def panels() -> Iterator[tuple[NDArray[np.intp], _Panel, Array, Array, Array]]:
        for j in range(edges.shape[1] - 1):
            candidates = np.flatnonzero(edges[:, j + 1] > edges[:, j])
            start = edges[candidates, j]
            level = potential(start[:, None] * directions[candidates])
            live = level < energy[candidates]
            rays, start, level = candidates[live], start[live], level[live]
            if rays.size:
                end = edges[rays, j + 1]
                inside = np.isfinite(end)
                end_level = np.full(end.shape, np.inf)
                if inside.any():
                    end_level[inside] = potential(end[inside, None] * directions[rays[inside]])
                engaged = np.where(touch[rays] <= start[:, None], reach[rays], 0.0)
                yield rays, _Panel(potential, start, engaged), level, end_level, end - start

    return edges[:, 0], panels()


def _free_share(energy: Array, end: Array) -> Array:
    """½ r²/H at the first stop, 1 at the most."""
    with np.errstate(over="ignore"):
        return np.asarray(np.minimum(end * end / (2.0 * energy), 1.0))


def _beta_to(share: Array, x: float, y: float) -> Array:
    return np.asarray(beta(x, y) * betainc(x, y, share))


def _free_panel(energy: Array, end: Array, exponent: float, c: int) -> Array:
    """The integrals up to the first stop, where V = ½ r²; shape (rays, 3)."""
    share = _free_share(energy, end)
    half = 0.5 * c
    unit = 2.0 ** (half - 1.0)
    states = unit * _beta_to(share, half, exponent + 1.0)
    volume = unit * _beta_to(share, half, exponent + 2.0)
    if exponent > 0:
        slope = exponent * unit * _beta_to(share, half, exponent)
    else:
        slope = (exponent + half) * states
    return np.stack([states, volume, slope], axis=1)


@lru_cache
def _joined_rules(rules: tuple[int, ...]) -> tuple[Array, Array]:
    """Gauss points of all rules side by side, and their weights as a matrix (points, rules)."""
    parts = [gauss_legendre(points) for points in rules]
    weights = np.zeros((sum(rules), len(rules)))
    at = 0
    for k, (t, w) in enumerate(parts):
        weights[at : at + t.size, k] = w
        at += t.size
    return np.concatenate([t for t, _ in parts]), weights


class _Panel:
    """Smooth piece of the rays beyond ``start`` (rays,), with the stops engaged there."""

    def __init__(self, potential: ReducedPotential, start: Array, reach: Array) -> None:
        """Keep the stops that any of the rays has reached by ``start``; ``reach`` (rays, stops)."""
        self.start = start[:, None]
        self.dimension = potential.count
        self.engaged = []
        for s, stop in enumerate(potential.stops):
            if np.any(reach[:, s]):
                before = np.maximum(reach[:, s] * start - stop.clearance, 0.0)[:, None]
                self.engaged.append((stop, reach[:, s, None], before))

    def rise(self, x: Array) -> tuple[Array, Array]:
        """V(start + x) − V(start) and its slope, for x of shape (rays, ·)."""
        value = x * (self.start + 0.5 * x)
        slope = self.start + x
        for stop, reach, before in self.engaged:
            now = before + reach * x
            value = value + (stop.energy(now) - stop.energy(before))
            slope = slope + reach * stop.force(now)
        return value, slope

    def curvature(self, x: Array) -> Array:
        """Second derivative of V along the rays at start + x."""
        value = np.ones_like(x)
        for stop, reach, before in self.engaged:
            value = value + reach**2 * stop.slope(before + reach * x)
        return value

    def fall(self, x: Array, X: Array, distance: Array) -> Array:
        """V(start + X) − V(start + x) given X − x as ``distance``, without cancelling springs."""
        value = distance * (self.start + 0.5 * (X + x))
        for stop, reach, before in self.engaged:
            value = value + (stop.energy(before + reach * X) - stop.energy(before + reach * x))
        return value

    def turning_point(self, height: Array) -> Array:
        """The x > 0 where the rise equals ``height`` (rays,), by Newton's method in logarithms.

        The rise is a sum of positive powers of x, so its logarithm is convex in log x and the
        iteration, started where the springs alone reach ``height``, comes down on the root
        monotonically: that start and zero bracket it.
        """
        start = self.start[:, 0]
        x = 2.0 * height / (start + np.sqrt(start * start + 2.0 * height))
        for _ in range(NEWTON_STEPS):
            value, slope = (part[:, 0] for part in self.rise(x[:, None]))
            step = np.log(value / height) * value / (x * slope)
            x = x * np.exp(-step)
            # Quadratic convergence: the next step would be of the order of the square of this.
            if np.max(np.abs(step)) < 1e-8:
                break
        return x

    def end_angle(self, left: Array, X: Array, length: Array) -> Array:
        """Angle φ of x = X sin²φ at the panel's end, where ``left`` = H − V is left, or π/2.

        Just short of the turning point X − length cancels; there it is ``left`` over the slope
        half-way, whose relative error is of the order of its square.
        """
        inner = left > 0.0
        if not inner.any():
            return np.full(X.shape, 0.5 * np.pi)
        short = np.where(inner, X - np.where(inner, length, 0.0), 0.0)
        near = inner & (short < 1e-5 * X)
        if near.any():
            slope = self.rise(0.5 * (X + np.where(inner, length, X))[:, None])[1][:, 0]
            short = np.where(near, left / slope, short)
        return np.arctan2(np.sqrt(X - short), np.sqrt(short))

    def integrals(
        self,
        energy: Array,
        level: Array,
        end_level: Array,
        length: Array,
        *,
        exponent: float,
        rules: Sequence[int],
    ) -> Array:
        """The three integrals over this panel, from ``start`` to its end or the turning point."""
        H = energy[:, None]
        x, r, v, slope_of_x, factor, weights = self.points(energy, level, end_level, length, rules)
        c = self.dimension
        measure = slope_of_x * half_integer_power(v, exponent)
        if c > 1:
            measure = measure * (r / np.sqrt(H)) ** (c - 1)
        if exponent > 0:
            w = exponent / v
        else:
            rise, slope = self.rise(x)
            V = level[:, None] + rise
            w = V * ((c - 1) / (r * slope) - self.curvature(x) / (slope * slope))
            w += exponent + 1.0
        parts = [(part @ weights) * factor for part in (measure, measure * v, measure * w)]
        return np.stack(parts, axis=-1).transpose(1, 0, 2)

    def moments(
        self,
        energy: Array,
        level: Array,
        end_level: Array,
        length: Array,
        *,
        exponent: float,
        orders: Sequence[tuple[int, int]],
        rules: Sequence[int],
    ) -> Array:
        """The integrals of ``shell_ray_moments`` over this panel."""
        _, r, v, slope_of_x, factor, weights = self.points(energy, level, end_level, length, rules)
        r = r / np.sqrt(energy)[:, None]
        base = slope_of_x * half_integer_power(v, exponent)
        radial = {k: r ** (k + self.dimension - 1) for k, _ in orders}
        kinetic = {j: base * v**j for _, j in orders}
        parts = [((radial[k] * kinetic[j]) @ weights) * factor for k, j in orders]
        return np.stack(parts, axis=-1).transpose(1, 0, 2)

    def points(
        self, energy: Array, level: Array, end_level: Array, length: Array, rules: Sequence[int]
    ) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Gauss points of the panel: x, r, v (rays, points), then what makes integrals of them.

        An integral is ``(slope_of_x * f) @ weights * factor``, in units of √H, per rule.
        """
        X = self.turning_point(energy - level)
        phi_end = self.end_angle(energy - end_level, X, length)[:, None]
        t, weights = _joined_rules(tuple(rules))
        phi = 0.5 * phi_end * (1.0 + t)
        sine, cosine = np.sin(phi), np.cos(phi)
        x = X[:, None] * (sine * sine)
        H = energy[:, None]
        v = self.fall(x, X[:, None], X[:, None] * (cosine * cosine)) / H
        factor = phi_end * X[:, None] / np.sqrt(H)
        return x, self.start + x, v, sine * cosine, factor, weights


def half_integer_power(x: Array, exponent: float) -> Array:
    """Return x**exponent for an exponent that is a multiple of ½, by roots and products."""
    whole, odd = divmod(round(2 * exponent), 2)
    result: Array = np.sqrt(x) if odd else np.ones_like(x)
    if whole < 0:
        return result / x ** (-whole)
    return result * x**whole if whole else result
