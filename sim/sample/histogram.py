"""Histograms: their ranges and bins, and the densities that follow from counts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from itertools import pairwise
from math import inf, isfinite, nan, pi, sqrt

import numpy as np

from fpk.answer.bins import BinAxis, LogReference, no_reference
from fpk.answer.certificate import Measured, certify
from fpk.answer.names import Coordinate, Observable
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import ROUND_OFF, SMALLEST, Array, Integers
from fpk.system.linear import modal_energies, natural_modes
from fpk.system.system import System, effects_of
from sim.step.step_size import temperature

BINS = (1024, 128)
"""Number of bins on the axis of a histogram of one coordinate; on each axis of two."""
MARGIN = 0.3
"""Margin of a histogram beyond each extreme of the pilot states, in units of their range."""
DEEPEST = 30.0
"""Contact energy in units of kT at the end of the bins beyond a stop; p has fallen by e^−30."""
LOWEST, SHARE = 400, 0.35
"""p is taken to rise towards H = 0 if more than ``SHARE`` of the ``LOWEST`` sampled energies lie in
the lowest quarter of their range. The share is 0.25 ± 0.022 (one standard error) for a smooth p,
and 0.5 for p ~ H^(−1/2)."""
LARGEST_TAIL = 1e-3
"""Largest share of samples outside the histogram of a certified density."""


@dataclass(frozen=True, eq=False)
class Histogram:
    """Bins of an observable, one axis for each coordinate."""

    observable: Observable
    bins: tuple[BinAxis, ...]

    @property
    def edges(self) -> tuple[Array, ...]:
        """Ascending edges of the bins of each axis."""
        return tuple(axis.edges for axis in self.bins)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of bins along each axis."""
        return tuple(e.size - 1 for e in self.edges)

    @property
    def size(self) -> int:
        """Number of bins; the bin for samples outside is not included."""
        return int(np.prod(self.shape))

    def counted(self, columns: Sequence[Array], groups: int = 1) -> Integers:
        """Return the counts (``groups``, bins + 1) of samples, the last bin for samples outside.

        Bins of two coordinates are in C order; the upper end of an axis, and NaN, are outside.
        ``columns``: the values (samples,) of each coordinate; sample k belongs to group k % groups.
        """
        bins, inside = np.array(0), np.array(True)
        for x, e in zip(columns, self.edges, strict=True):
            inside = inside & (x >= e[0]) & (x < e[-1])
            bins = bins * (e.size - 1) + np.searchsorted(e, x, side="right") - 1
        number = np.where(inside, bins, self.size)
        index, each = np.arange(number.size) % groups, self.size + 1
        return np.bincount(index * each + number, minlength=groups * each).reshape(groups, -1)


def bin_axis(
    low: float, high: float, kinks: Sequence[float], bins: int, *, widening: bool,
    reference: LogReference = no_reference,
) -> BinAxis:  # fmt: skip
    """Return about ``bins`` bins from ``low`` to ``high``, equally many between any two ``kinks``.

    The number between two is 32 or more. Kinks outside [``low``, ``high``) are ignored.
    ``widening``: above a kink bins widen (see ``BinAxis``), since p may have a root there: (H −
    H_c)^(1/2) if contact begins, H^(−1/4) for a stop without clearance, H^(−1/2) after a start at
    rest. ``reference``: ln r of ``BinAxis``.
    """
    inside = list[float]()
    for kink in sorted(k for k in kinks if low <= k < high):
        if not inside or kink - inside[-1] > ROUND_OFF * (high - low):
            inside.append(kink)
    nodes = [low, *(k for k in inside if k > low), high]
    each = max(32, bins // (len(nodes) - 1) // 8 * 8)  # can be joined by 8
    edges, share = [np.array([low])], np.linspace(0.0, 1.0, each + 1)[1:]
    for a, b in pairwise(nodes):
        edges.append(a + (b - a) * (share**4 if widening and a in inside else share))
        edges[-1][-1] = b
    at = tuple(inside)
    return BinAxis(np.concatenate(edges), at, at if widening else (), reference)


def kinks_of(system: System, coordinate: Coordinate) -> list[float]:
    """Return, ascending, the values of ``coordinate`` at which its density may have a kink.

    For q_i the stops of mass i; for p_i none; for H the least energy to touch each stop, ½ δ²/C_ii
    plus the contact energy of nearer stops, C the compliance; for H_m ½ (ω_m δ/T_im)², the energy
    if mode m alone moves.
    """
    at = [(stop.index, stop.sign * stop.clearance) for stop in system.stops]
    kinks: list[float] = []
    if coordinate.kind == "q":
        kinks = [x for i, x in at if i == coordinate.row]
    elif coordinate.kind == "H" and coordinate.index is None:
        C = system.compliance
        kinks = [0.5 * x * x / float(C[i, i]) + float(system.contact_energy(i, x)) for i, x in at]
    elif coordinate.kind == "H":
        shapes, omega = (x[..., coordinate.row] for x in natural_modes(system))
        kinks = [0.5 * float(omega * x / shapes[i]) ** 2 for i, x in at if shapes[i] != 0.0]
    return sorted(set(kinks))


def axis_of(
    system: System, coordinate: Coordinate, low: float, high: float, bins: int,
    *, rises: bool = False,
) -> BinAxis:  # fmt: skip
    """Return about ``bins`` bins of ``coordinate`` that cover ``low`` to ``high`` with a margin.

    Bins of energies start at 0; ``rises``: the density may rise towards 0. Bins of q and p are
    symmetric about 0 if the system has mirror symmetry. Beyond the outermost stop within the range
    bins of q end at a contact energy of ``DEEPEST`` kT, or later if the range itself is so deep.
    """
    energy, reach, wide = coordinate.kind == "H", MARGIN * (high - low), 1.0 + 2.0 * MARGIN
    mirror = effects_of(system).mirror and not energy
    kinks = [*([0.0] if energy and rises else []), *kinks_of(system, coordinate)]
    if energy:
        low, high = 0.0, wide * high
    elif mirror:
        high = wide * max(-low, high)
        low = -high
    else:
        low, high = low - reach, high + reach

    def end(side: float, x: float) -> float:
        """Return the end of the bins of ``side`` · q, at most ``x``, the end with a full margin."""
        own = (s for s in system.stops if (s.index, s.sign) == (coordinate.row, side))
        stop = max((s for s in own if s.clearance < x), key=lambda s: s.clearance, default=None)
        if stop is None:
            return x
        depth, kT = max(wide * (x - reach - stop.clearance), 0.0), temperature(system)
        if isfinite(kT) and kT > 0.0:
            depth = max(depth, stop.overlap_at(DEEPEST * kT))
        return min(x, stop.clearance + depth) if depth > 0.0 else x

    if coordinate.kind == "q":
        low, high = -end(-1.0, -low), end(1.0, high)
    reference = partial(log_reference, system, coordinate)
    axis = bin_axis(low, high, kinks, bins, widening=energy, reference=reference)
    # Symmetric to the last digit.
    return replace(axis, edges=0.5 * (axis.edges - axis.edges[::-1])) if mirror else axis


def extremes(system: System, observables: Sequence[Observable], q: Array, p: Array) -> Array:
    """Return minima, maxima (coordinates, 2) of ``observables`` over ``q``, ``p`` (samples, n)."""
    # The rounding of sums over masses depends on the layout in memory.
    q, p = np.ascontiguousarray(q), np.ascontiguousarray(p)
    values = [values_of(system, c, q, p) for observable in observables for c in observable]
    return np.array([(x.min(), x.max()) for x in values]).reshape(-1, 2)


def values_of(system: System, coordinate: Coordinate, q: Array, p: Array) -> Array:
    """Return ``coordinate`` (samples,) at ``q``, ``p`` (samples, n); H_m lacks contact energy."""
    if coordinate.kind != "H":
        return (q if coordinate.kind == "q" else p)[:, coordinate.index]
    if coordinate.index is None:
        return system.hamiltonian(q, p)
    return np.asarray(modal_energies(system, q, p)[:, coordinate.index])


def rises(energies: Array) -> bool:
    """Return whether the lowest of ``energies`` (samples,) crowd towards 0: see ``SHARE``.

    Besides the lowest ``LOWEST``, 4, 16, … times as many are tested, up to a quarter of all
    samples. False for fewer than 4 ``LOWEST`` samples.
    """
    x, count = np.sort(energies), LOWEST
    while 4 * count <= x.size:
        if np.count_nonzero(x < 0.25 * x[count]) > SHARE * count:
            return True
        count *= 4
    return False


def covering(
    observables: Sequence[Observable], reached: Array, axis: Callable[..., BinAxis]
) -> tuple[Histogram, ...]:
    """Return histograms of ``observables`` over the ranges ``reached`` (coordinates, 2).

    ``axis(coordinate, low, high, bins)`` makes the bins, as ``axis_of`` does for a system. A range
    with NaN becomes −1 to 1.
    """
    # NaN: −1 to 1.
    ends = iter(np.where(reached[:, :1] <= reached[:, 1:], reached, (-1.0, 1.0)).tolist())
    return tuple(
        Histogram(o, tuple(axis(c, *next(ends), BINS[len(o) - 1]) for c in o)) for o in observables
    )


def starts(histograms: Sequence[Histogram]) -> Integers:
    """Return the index of the first counter of each histogram, then the number of all counters.

    A histogram has one counter more than bins, for samples outside. Shape (histograms + 1,).
    """
    return np.cumsum([0] + [h.size + 1 for h in histograms], dtype=np.int64)


def add_mirror_images(histogram: Histogram, counts: Integers) -> Integers:
    """Return ``counts`` (batches, bins + 1) plus mirror images (−q, −p); the last bin doubles."""
    axes = tuple(a for a, c in enumerate(histogram.observable, start=1) if c.kind != "H")
    reflected = np.flip(counts[:, :-1].reshape(-1, *histogram.shape), axis=axes)
    return np.hstack([counts[:, :-1] + reflected.reshape(len(counts), -1), 2 * counts[:, -1:]])


def log_reference(system: System, coordinate: Coordinate, x: Array, bins: Integers) -> Array:
    """Return an approximation of ln p at each ``x``, without its constant; a ``LogReference``.

    −U_i/kT for q_i, Eq. (7), U_i the contact energy; (n − 1) ln H for H; else 0. ``bins``, the
    numbers of their bins, are not used.
    """
    if coordinate.kind == "H" and coordinate.index is None:
        return log_states(system.n, x, bins)
    if coordinate.kind == "q" and coordinate.row in system.contact_masses:
        return -system.contact_energy(coordinate.row, x) / temperature(system)
    return np.zeros_like(x)


def log_states(n: int, energy: Array, bins: Integers) -> Array:
    """Return ln H^(n−1) at each ``energy`` H: ln of the density of states of ``n`` masses near 0.

    ``bins``, the numbers of their bins, are not used.
    """
    return np.asarray((n - 1.0) * np.log(np.maximum(energy, SMALLEST)))


def density_of_counts(
    histogram: Histogram,
    counts: Integers,
    *,
    taken: int,
    mirror: bool = False,
    residual: float = 0.0,
    tol: float = inf,
    failures: Sequence[str] = (),
    everywhere: bool = True,
) -> SampledDensity:
    """Return the density of ``counts`` (batches, bins + 1) of ``taken`` samples, certified.

    With ``mirror`` the mirror image of each sample is counted, too. ``residual`` is the largest |z|
    of the moment identities, ``tol`` the tolerance of the expected L1 sampling error. ``failures``
    are words against the sample; wrong totals and too many samples outside are added to them, and
    with ``everywhere`` bins that do not resolve p.
    """
    total = counts.sum(axis=0)
    tail, words = float(total[-1]) / max(1, taken), list(failures)
    if int(total.sum()) != taken:
        words.append(f"{int(total.sum())} samples were counted of {taken} taken")
    if tail > LARGEST_TAIL:
        words.append(f"{tail:.2g} of the samples lie outside the histogram")
    if mirror:
        counts = add_mirror_images(histogram, counts)
    whole, samples = max(1, counts.sum()), np.maximum(1, counts.sum(axis=1, keepdims=True))
    areas = reduce(np.multiply.outer, map(np.diff, histogram.edges))
    density = SampledDensity(
        histogram.observable,
        histogram.bins,
        (counts.sum(axis=0)[:-1] / whole).reshape(histogram.shape) / areas,
        (counts[:, :-1] / samples).reshape(-1, *histogram.shape) / areas,
        certify(Measured(nan, nan, nan, nan, nan), tol=0.0),  # provisional
        samples=whole,
    )
    middles = (0.5 * (e[1:] + e[:-1]) for e in histogram.edges)
    errors = density.at(*np.meshgrid(*middles, indexing="ij", sparse=True))[1]
    # E |x| of a normal x is √(2/π) standard errors. Next to a kink at an end: 100 %.
    errors = np.where(np.isfinite(errors), errors, density.values)
    error = sqrt(2.0 / pi) * float(np.sum(areas * errors))
    if everywhere:
        words += words_on_resolution(density)
    measured = Measured(
        l1_error=error,
        mass_defect=abs(float(total.sum()) / max(1, taken) - 1.0),
        minimum=float(density.values.min() / max(density.values.max(), SMALLEST)),
        residual=residual,
        tail_mass=tail,
        failures=tuple(words),
    )
    certificate = certify(measured, tol=tol, sampled=True)
    return replace(density, l1_error=error, certificate=certificate, made=density.fits)


def words_on_resolution(density: SampledDensity) -> list[str]:
    """Return a list: a sentence on the first range in which bins do not resolve p, or nothing."""
    for box in density.unresolved:
        ends = zip(density.observable, density.edges, box.first, box.last, strict=True)
        where = ", ".join(f"{c} = {e[a]:.4g} to {e[b]:.4g}" for c, e, a, b in ends)
        return [f"the density changes within a bin for {where}, and is not known there"]
    return []
