"""Tensor meshes of two energies: where they end and how long their elements are."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpk.errors import NotCertified
from fpk.plane.pointwise import evaluated, flux_free_slopes
from fpk.process import Process

Array = NDArray[np.float64]

PROBE = np.concatenate([[0.0], np.logspace(-2.0, 3.0, 52)])
"""Energies of the probe along each axis, in units of the process's scale."""
NEXT_TO_ZERO = 1e-4
"""Where the probe reads the slopes at H_i = 0, in the same unit: b vanishes on the axis itself."""
FINE = 512
"""Places between which an axis is divided."""
DEEP = 40.0
"""Nats by which p has to fall within the probe: what is left there, 4e-18, is below round-off."""
TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True, eq=False)
class Probe:
    """Guess of ln p and of its slopes (2, …) on the grid of ``PROBE``, in units of the scales.

    Meshes start from it: no answer rests on it.
    """

    log_density: Array
    slopes: Array

    @property
    def falls(self) -> bool:
        """Whether p H1 H2, the density over relative lengths, is least at the far edges."""
        log = np.log(np.maximum(PROBE, PROBE[1]))
        weighted = self.log_density + log[:, None] + log
        edges = max(weighted[-1].max(), weighted[:, -1].max())
        return bool(edges < weighted.max() - DEEP)


def probed(process: Process) -> Probe:
    """Return what the density would be if no probability flowed, ∇ ln p = b⁻¹ (2s − ∇·b).

    The integral is taken along two paths, first one energy, then the other, and the mean of both:
    exact where nothing flows (detailed balance), whatever the coupling. Where that does not fall
    off, much does flow, and the guess is the product of the marginals, each closed by an
    exponential of the other energy.

    Raises ``NotCertified`` where the density does not fall off, or b is singular off the axes.
    """
    inside = np.maximum(PROBE, NEXT_TO_ZERO)
    grid = np.stack(np.meshgrid(inside, inside, indexing="ij"), axis=-1).reshape(-1, 2)
    scales = np.array(process.energy_scales)
    slopes, regular = flux_free_slopes(*evaluated(process, grid * scales), scales)
    if not regular:
        raise NotCertified("some combination of the two energies gets no noise")
    first, second = slopes.reshape(2, PROBE.size, PROBE.size)
    along = _integral(first), _integral(second.T).T
    paths = along[0][:, :1] + along[1] + along[1][:1] + along[0]
    guess = Probe(0.5 * paths, np.stack([first, second]))
    return guess if guess.falls else _closed(process)


def _closed(process: Process) -> Probe:
    """The product of marginals: drift and diffusion averaged over an exponential other energy."""
    t, weight = np.polynomial.laguerre.laggauss(8)
    inside = np.maximum(PROBE, NEXT_TO_ZERO)
    slopes = []
    for axis in (0, 1):
        flow, diffusion = _coefficients(process, *((inside, t) if axis == 0 else (t, inside)))
        s, b = flow[..., axis], diffusion[..., axis, axis]
        s, b = (s, b) if axis == 0 else (s.T, b.T)
        slope = (s @ weight) / (b @ weight) * process.energy_scales[axis]
        log_p = _integral(slope[:, None])[:, 0]
        deep = np.flatnonzero(np.maximum.accumulate(log_p) - log_p > 0.5 * DEEP)
        if not deep.size:
            raise NotCertified(f"the density does not fall off along H{axis + 1}")
        # What the closure does farther out is not to be trusted: on at the mean slope so far.
        at = deep[0]
        top = int(np.argmax(log_p[:at]))
        slope[at:] = (log_p[at] - log_p[top]) / (PROBE[at] - PROBE[top])
        slopes.append(slope)
    first, second = (_integral(slope[:, None]) for slope in slopes)
    grid = np.broadcast_arrays(slopes[0][:, None], slopes[1])
    return Probe(first + second.T, np.stack(grid))


def _coefficients(process: Process, first: Array, second: Array) -> tuple[Array, Array]:
    """2s − ∇·b (…, 2) and b (…, 2, 2) on the grid of energies in units of the scales."""
    grid = np.meshgrid(first, second, indexing="ij")
    points = np.stack([x.ravel() for x in grid], axis=1) * process.energy_scales
    c = process.coefficients(points)
    flow, shape = 2.0 * c.drift - c.divergence, grid[0].shape
    return flow.reshape(*shape, 2), c.diffusion.reshape(*shape, 2, 2)


def _integral(slope: Array) -> Array:
    """Trapezoidal ∫ from 0 along the first axis of the probe."""
    steps = 0.5 * (slope[1:] + slope[:-1]) * np.diff(PROBE)[:, None]
    return np.concatenate([np.zeros_like(slope[:1]), np.cumsum(steps, axis=0)])


def axis_nodes(probe: Probe, axis: int, *, tail: float, tol: float, degree: int) -> Array:
    """Return nodes in units of the scale, from 0 to where about the share ``tail`` lies beyond.

    Between them polynomials of ``degree`` meet p to ``tol`` of the whole mass: over a length h the
    least error is 2 (h/4)^k |p^(k)|/k!, k = degree + 1, with |p^(k)| at the middle for an
    exponential, which is what the mean of its logarithm finds, and 2/π of that on average.
    """
    log_p, slope = probe.log_density, probe.slopes[axis]
    bend = -np.gradient(slope, PROBE, axis=axis)
    if axis == 1:
        log_p, slope, bend = log_p.T, slope.T, bend.T
    width = np.gradient(PROBE)
    log_p = log_p + np.log(width)
    p = np.exp(log_p - log_p.max())
    beyond = np.cumsum((p.sum(axis=1) * width)[::-1])[::-1]
    share = np.log(np.maximum(beyond / beyond[0], TINY))
    end = float(np.interp(-np.log(tail), -share, PROBE))
    rows = slice(0, int(np.searchsorted(PROBE, end)) + 1)
    k = degree + 1
    change = log_p[rows] - log_p.max() + log_derivative(slope[rows], bend[rows], k)
    top = change.max(axis=1)
    total = top + np.log(np.exp(change - top[:, None]).sum(axis=1)) - np.log(beyond[0])
    fine = np.linspace(0.0, end, FINE + 1)
    along = np.interp(fine, PROBE[rows], total)
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (along[1:] + along[:-1]))])
    allowed = np.log(0.25 * np.pi * tol) + k * np.log(4.0)
    cuts, at = [0], 0
    while at < FINE:
        length = np.arange(1, FINE + 1 - at)
        error = (k + 1) * np.log(length * fine[1]) + (summed[at + 1 :] - summed[at]) / length
        too_long = np.flatnonzero(error > allowed)
        at += max(int(too_long[0]), 1) if too_long.size else FINE - at
        cuts.append(at)
    return np.asarray(_evened(np.array(cuts, float)) * fine[1])


def log_derivative(slope: Array, bend: Array, k: int) -> Array:
    """Return ln |p^(k)|/(k! p) of p = exp(slope x − bend x²/2) by Cauchy's estimate on a circle.

    On the best radius: k/|slope| for an exponential, √(k/bend) near the top of a Gaussian.
    """
    g, c = np.maximum(np.abs(slope), 1e-9), np.maximum(bend, 1e-18)
    top = g * g < 4.0 * k * c
    near = 0.25 * g * g / c + 0.5 * k * (1.0 + np.log(c / k))
    radius = 2.0 * k / (g + np.sqrt(np.maximum(g * g - 4.0 * k * c, 0.0)))
    far = g * radius - 0.5 * c * radius**2 - k * np.log(radius)
    return np.asarray(np.where(top, near, far))


def _evened(cuts: Array) -> Array:
    """The last interval is what was left: let the others give it its part."""
    if cuts.size == 2:
        return cuts
    longest = cuts[-2] + (cuts[-2] - cuts[-3])
    units = cuts.size - 2 + min(1.0, (cuts[-1] - cuts[-2]) / (longest - cuts[-2]))
    places = np.linspace(0.0, units, cuts.size)
    inner = np.interp(places[:-1], np.arange(cuts.size), [*cuts[:-1], max(longest, cuts[-1])])
    return np.append(inner, cuts[-1])


def bisected(nodes: Array, marked: NDArray[np.bool_]) -> Array:
    """Return the nodes with the marked intervals halved."""
    middle = 0.5 * (nodes[1:] + nodes[:-1])
    return np.sort(np.concatenate([nodes, middle[marked]]))
