"""Densities at several times from ensembles at two steps, counted in groups of trajectories."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import inf

import numpy as np

from fpk.arrays import Array, Integers
from fpk.bins import BinAxis
from fpk.certificate import Measured, certify, outside, worst
from fpk.errors import InvalidInput
from fpk.evolution import Transient
from fpk.observable import Observable
from fpk.sampled_density import SampledDensity
from sim.histogram import Histogram, covering, rises, sampled_density, unresolved_words

GROUPS = 64
"""Independent batches of trajectories, from which errors are taken."""


class Counted:
    """Histograms of one observable at several times, their ranges from the first round.

    ``read`` gives the coordinates of the observable, (paths,) each, of states (paths, ...);
    ``axis`` makes the bins of a coordinate, as ``axis_of`` does.
    """

    def __init__(
        self,
        observable: Observable,
        times: int,
        read: Callable[[Array], Sequence[Array]],
        axis: Callable[..., BinAxis],
        *,
        mirror: bool = False,
    ) -> None:
        """Begin with none."""
        self.observable, self.read, self.axis, self.mirror = observable, read, axis, mirror
        self.histograms: list[Histogram] = []
        self.counts: list[Integers] = []  # of each time: (2, GROUPS, bins + 1)
        self.paths = [0] * times
        self.stepped = False

    def add(self, k: int, time: float, fine: Array, coarse: Array | None) -> None:
        """Count the states (paths, ...) of time number ``k``, at half the step and at the step."""
        self.stepped = coarse is not None
        for which, states in enumerate((fine,) if coarse is None else (fine, coarse)):
            columns = self.read(states)
            if k == len(self.histograms):
                self.histograms.append(self._covering(columns, time))
                self.counts.append(np.zeros((2, GROUPS, self.histograms[k].size + 1), np.int64))
            self.counts[k][which] += self.histograms[k].counted(columns, GROUPS)
        self.paths[k] += len(fine)

    def densities(self, which: int = 0) -> list[SampledDensity]:
        """Return the densities at all times, of the finer simulation or the coarser one (1)."""
        return [
            sampled_density(
                histogram, counts[which], taken=paths, mirror=self.mirror, everywhere=False
            )
            for histogram, counts, paths in zip(
                self.histograms, self.counts, self.paths, strict=True
            )
        ]

    @property
    def error(self) -> float:
        """Largest expected L1 error of the densities at all times, of the finer simulation."""
        return max(density.l1_error for density in self.densities())

    def _covering(self, columns: Sequence[Array], time: float) -> Histogram:
        reached = np.zeros((len(columns), 2))
        for c, x, ends in zip(self.observable, columns, reached, strict=True):
            ends[:] = x.min(), x.max()
            if not ends[1] - ends[0] > 1e-9 * np.max(np.abs(ends)):
                words = f"{c} is one value at t = {time:g}, and has no density; ask for later times"
                raise InvalidInput("times", time, words)
        low = [x for c, x in zip(self.observable, columns, strict=True) if c.kind == "H"]
        axis = partial(self.axis, rises=any(map(rises, low)))
        return covering([self.observable], reached, axis)[0]


def answer_of(
    counted: Counted, times: Array, at: tuple[Array, ...], dt: float, *,
    settings: Mapping[str, str | float | int], failures: Sequence[str] = (), tol: float,
) -> Transient:  # fmt: skip
    """Return the densities at ``times`` at the points ``at``, ``dt`` being the longer step.

    In the error are, in quadrature, one standard error by the groups and what changes at the longer
    step. Where the bins do not show the density errors are inf and nothing is certified.
    """
    fine = counted.densities()
    coarse = counted.densities(1) if counted.stepped else fine
    values, errors, bias, wide = [], [], 0.0, list[str]()
    for time, a, b in zip(times.tolist(), fine, coarse, strict=True):
        value, error = a.at(*at)
        step, lost = b.at(*at)[0] - value, a.fits.are_unresolved(np.stack(at))
        values.append(value)
        errors.append(np.where(lost, inf, np.hypot(error, step)))
        if lost.any():
            wide.append(f"at t = {time:g} {unresolved_words(a)[0]}; ask for later times")
        bias = max(bias, float(np.max(np.abs(step), initial=0.0)))
    certificates = [density.certificate for density in fine]
    own = dict.fromkeys(words for c in certificates for words in c.failures)
    measured = Measured(
        l1_error=max(density.l1_error for density in fine),
        mass_defect=worst(c.mass_defect for c in certificates),
        minimum=min((x for c in certificates if (x := c.minimum) is not None), default=None),
        residual=worst(c.residual for c in certificates),
        tail_mass=max(map(outside, certificates)),
        failures=(*failures, *own, *wide[:1]),
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
