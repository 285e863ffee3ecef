"""Noise of intensity e(t)² D that varies with time."""

from dataclasses import dataclass

import numpy as np
from scipy.special import hyp1f1

from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotApplicable, require


@dataclass(frozen=True, eq=False)
class Modulation:
    """Factor e(t) on the noise, linear between ``times`` and constant after the last.

    ``times`` ascend from 0; each ``factor`` is 0 or between 1e-150 and 1e150, so that its square
    does not under- or overflow. Stationary states are for e = 1 at all times.

    Raises ``InvalidInput`` for anything else.
    """

    times: Array
    factor: Array

    def __post_init__(self) -> None:
        """Check both lists, or raise ``InvalidInput``; store them as read-only arrays."""
        least, most = 1e-150, 1e150
        for key in ("times", "factor"):
            try:
                array = np.array(getattr(self, key), dtype=float)
            except (TypeError, ValueError):
                array = np.array(np.nan)
            fits = array.ndim == 1 and array.size > 0 and np.isfinite(array).all()
            require(fits, key, getattr(self, key), "must be a list of finite numbers")
            array.setflags(write=False)
            object.__setattr__(self, key, array)
        times, e = self.times, self.factor
        ascend = times[0] == 0.0 and np.all(np.diff(times) > 0.0)
        require(ascend, "times", times, "must begin with 0 and ascend")
        require(e.size == times.size, "factor", e, f"must have {times.size} entries, one per time")
        require(np.all(e >= 0.0), "factor", e, "must not be negative")
        words = f"must be 0 or from {least:g} to {most:g}, for its square"
        require(np.all((e == 0.0) | (e >= least) & (e <= most)), "factor", e, words)

    def __call__(self, time: Array) -> Array:
        """Return e at ``time`` >= 0, of any shape."""
        return np.asarray(np.interp(time, self.times, self.factor))

    @property
    def largest(self) -> float:
        """Largest e² at any time."""
        return float(self.factor.max()) ** 2

    @property
    def last(self) -> float:
        """e² after the last time."""
        return float(self.factor[-1]) ** 2

    def after(self, time: float) -> "Modulation":
        """Return the modulation e(``time`` + t) for t >= 0."""
        later = self.times[self.times > time]
        return Modulation(np.append(0.0, later - time), self(np.append(time, later)))

    def energy(self, time: Array) -> Array:
        """Return ∫e² dt from 0 to ``time`` >= 0, of any shape."""
        e, t = self.factor, self.times
        k = np.searchsorted(t, time, side="right") - 1
        whole = np.append(0.0, np.cumsum(np.diff(t) * _square(e[:-1], e[1:])))
        return np.asarray(whole[k] + (time - t[k]) * _square(e[k], self(time)))

    def mean_square(self, begin: Array, step: float) -> Array:
        """Return the mean of e² over steps of length ``step`` from times ``begin``, any shape."""
        first, last = np.asarray(begin)[..., None], np.asarray(begin)[..., None] + step
        inner = self.times[(self.times > np.min(first)) & (self.times < np.max(last))]
        nodes = np.concatenate([first, np.clip(inner, first, last), last], axis=-1)
        e = self(nodes)
        return np.asarray(np.sum(np.diff(nodes) * _square(e[..., :-1], e[..., 1:]), axis=-1) / step)

    def faded(self, begin: float, end: float, rate: Array) -> Array:
        """Return ∫e(s)² exp(−rate (end − s)) ds from ``begin`` to ``end``, ``rate`` of any shape.

        A negative ``rate`` means growth. The relative error is at most
        ``LARGEST_LOG`` · EPS: 2e-15 by SciPy's 1F1, the rest by exponents up to 700.
        """
        inner = self.times[(self.times > begin) & (self.times < end)]
        nodes = np.concatenate([[begin], inner, [end]])
        e, h = self(nodes), np.diff(nodes)
        rate = np.asarray(rate, dtype=float)[..., None]
        # e = e_0 y + e_1 (1 − y) on a segment, y = 1 at its begin: ∫_0^1 e² e^(−uy) dy is a sum of
        # Beta integrals without negative terms.
        F = [hyp1f1(j, 4, -rate * h) for j in (1, 2, 3)]
        each = h / 3.0 * (e[1:] ** 2 * F[0] + e[:-1] * e[1:] * F[1] + e[:-1] ** 2 * F[2])
        return np.asarray(np.sum(each * np.exp(-rate * (end - nodes[1:])), axis=-1))


def _square(first: Array, last: Array) -> Array:
    """Mean square of a function that changes linearly from ``first`` to ``last``."""
    return np.asarray((last**2 + last * first + first**2) / 3.0)


def require_constant_noise(modulation: Modulation | None) -> None:
    """Raise ``NotApplicable`` if the system has a ``modulation``."""
    if modulation is not None:
        raise NotApplicable("the noise is modulated, which this route does not take into account")
