"""Densities at several times from ensembles at two steps, counted in groups of trajectories."""

from collections.abc import Callable, Mapping, Sequence
from math import inf

import numpy as np

from fpk.arrays import Array, Integers
from fpk.certificate import Measured, certify, outside, worst
from fpk.errors import InvalidInput
from fpk.evolution import Transient
from fpk.observable import Observable
from fpk.sampled_density import SampledDensity
from fpk.system import System
from sim.histogram import BINS, MARGIN, Histogram, sampled_density
from sim.motion.resolution import misfit, too_wide
from sim.motion.stationary import lost_words

GROUPS = 64
"""Independent batches of trajectories, from which errors are taken."""


class Counted:
    """Histograms of one observable at several times, their ranges from the first round.

    ``read`` gives the coordinates of the observable, (paths,) each, of states (paths, ...);
    ``system`` as of ``sampled_density``.
    """

    def __init__(
        self,
        observable: Observable,
        times: int,
        read: Callable[[Array], Sequence[Array]],
        *,
        mirror: bool = False,
        system: System | None = None,
    ) -> None:
        """Begin with none."""
        self.observable, self.read = observable, read
        self.mirror, self.system = mirror, system
        self.histograms: list[Histogram] = []
        self.counts: list[Integers] = []  # of each time: (2, GROUPS, bins + 1)
        self.paths, self.lost = [0] * times, 0
        self.stepped = False

    def add(self, k: int, time: float, fine: Array, coarse: Array | None) -> None:
        """Count the states (paths, ...) of time number ``k``, at half the step and at the step."""
        self.stepped = coarse is not None
        for which, states in enumerate((fine,) if coarse is None else (fine, coarse)):
            columns = self.read(states)
            if k == len(self.histograms):
                self.histograms.append(self._covering(columns, time))
                self.counts.append(np.zeros((2, GROUPS, self.histograms[k].size + 1), np.int64))
            histogram, group = self.histograms[k], np.arange(len(states)) % GROUPS
            bins = np.zeros(len(states), dtype=np.int64)
            inside = np.ones(len(states), dtype=bool)
            for x, e, many in zip(columns, histogram.edges, histogram.shape, strict=True):
                place = (x - e[0]) * (many / (e[-1] - e[0]))
                inside &= (place >= 0.0) & (place < many)
                bins = bins * many + np.where(inside, place, 0.0).astype(np.int64)
            index = group * (histogram.size + 1) + np.where(inside, bins, histogram.size)
            counts = np.bincount(index, minlength=GROUPS * (histogram.size + 1))
            self.counts[k][which] += counts.reshape(GROUPS, -1)
            self.lost += int(np.count_nonzero(~np.isfinite(states).all(axis=1)))
        self.paths[k] += len(fine)

    def densities(self, which: int = 0) -> list[SampledDensity]:
        """Return the densities at all times, of the finer simulation or the coarser one (1)."""
        return [
            sampled_density(
                histogram, counts[which], taken=paths, mirror=self.mirror, system=self.system
            )
            for histogram, counts, paths in zip(
                self.histograms, self.counts, self.paths, strict=True
            )
        ]

    def _covering(self, columns: Sequence[Array], time: float) -> Histogram:
        edges = []
        for c, x in zip(self.observable, columns, strict=True):
            x = x[np.isfinite(x)]
            low, high = (float(x.min()), float(x.max())) if x.size else (0.0, 1.0)
            if not high - low > 1e-9 * max(abs(low), abs(high)):
                words = f"{c} is one value at t = {time:g}, and has no density; ask for later times"
                raise InvalidInput("times", time, words)
            reach = MARGIN * (high - low)
            low, high = low - reach, high + reach
            if c.kind == "H":
                low = max(low, 0.0)
            elif self.mirror:
                high = max(-low, high)
                low = -high
            edges.append(np.linspace(low, high, BINS[len(self.observable) - 1] + 1))
        return Histogram(self.observable, tuple(edges))


def answer_of(
    counted: Counted, times: Array, at: tuple[Array, ...], dt: float, *,
    settings: Mapping[str, str | float | int], failures: Sequence[str] = (), tol: float,
) -> Transient:  # fmt: skip
    """Return the densities at ``times`` at the points ``at``, ``dt`` being the longer step.

    In the error are, in quadrature, one standard error by the groups, what changes at the longer
    step, what changes on bins twice as wide, and what the fit misses, see ``misfit`` and
    ``_at_rest``. Where bins are
    too wide for what the density does within one, errors are inf and nothing is certified.
    """
    fine = counted.densities()
    coarse = counted.densities(1) if counted.stepped else fine
    values, errors, bias, wide = [], [], 0.0, list[str]()
    for time, a, b in zip(times.tolist(), fine, coarse, strict=True):
        value, error = a.at(*at)
        wider = a.joined(2).at(*at)[0]
        step = b.at(*at)[0] - value
        missed, lost = misfit(a, *at)
        error = np.sqrt(error**2 + (wider - value) ** 2 + step**2 + (missed * value) ** 2)
        values.append(value)
        errors.append(np.hypot(np.where(lost, inf, error), _at_rest(counted, a, at)))
        if lost.any():
            wide.append(too_wide(a, time, [x[lost][0] for x in at]))
        bias = max(bias, float(np.max(np.abs(step), initial=0.0)))
    certificates = [density.certificate for density in fine]
    own = dict.fromkeys(words for c in certificates for words in c.failures)
    measured = Measured(
        l1_error=max(density.l1_error for density in fine),
        mass_defect=worst(c.mass_defect for c in certificates),
        minimum=min((x for c in certificates if (x := c.minimum) is not None), default=None),
        residual=worst(c.residual for c in certificates),
        tail_mass=max(map(outside, certificates)),
        failures=(*failures, *lost_words(counted.lost, dt), *own, *wide[:1]),
    )
    settings = {
        "trajectories": min(counted.paths),
        **settings,
        "expected L1 error": measured.l1_error,
    }
    if counted.stepped:
        settings |= {"dt": 0.5 * dt, "coarse dt": dt, "largest difference of both": bias}
    certificate = certify(measured, tol=tol, sampled=True)
    return Transient(times, np.array(values), np.array(errors), "sampling", certificate, settings)


def _at_rest(counted: Counted, density: SampledDensity, at: tuple[Array, ...]) -> Array:
    """Return the error of the first bin of a density of H of n >= 2 masses, at the energies ``at``.

    The exact density falls as H^(n−1) towards H = 0, where it is 0. At early times it does so
    within the first bin, so that no sample shows it: the error is what the sampled density has at
    H = 0. It is 0 in other bins, and for any other observable.
    """
    of_all = counted.system is not None and counted.system.n > 1 and len(at) == 1
    if not (of_all and str(counted.observable[0]) == "H"):
        return np.zeros(at[0].shape)
    edges = density.edges[0]
    at_zero = np.abs(density(np.zeros(1)))
    return np.asarray(np.where(at[0] < edges[1], at_zero if edges[0] == 0.0 else 0.0, 0.0))
