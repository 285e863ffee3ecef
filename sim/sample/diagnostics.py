"""Report of a simulation: moment identities, autocorrelation times, effective samples, drift.

τ is the integrated autocorrelation time ∫₀^∞ ρ(t) dt of a quantity with the variance σ². The mean
of the quantity over a time T of a trajectory has the variance ``2 σ² τ/T · (1 − O(τ/T))``, so that
τ follows from independent trajectories without an autocovariance: ``τ = T var(path means)/(2 σ²)``.
N trajectories have ``N T/(2τ)`` effective samples; ``N σ²/var(path means)`` holds below τ, too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import takewhile
from math import inf, nan, pi, sqrt
from typing import Literal

import numpy as np
from scipy.special import stdtrit

from fpk.answer.density import AnyDensity, l1_distance
from fpk.answer.method import Identity
from fpk.answer.quantities import Number
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import Array, Integers
from fpk.system.system import System

Product = tuple[str, int, str, int]
"""A product of two observed numbers, (kind, mass, kind, mass), masses from 0. Kinds are "q", "p",
"f", the force K q + g(q) of springs and contacts, and "d", the force of the damping terms."""
LEAST_TIMES = 50.0
"""Least number of effective samples of a certified run (emcee's rule: 50 times 2τ)."""
LEAST_BURN_IN = 5.0
"""Least burn-in in units of τ: e^−5 = 0.7 % of the deviation of the start remains."""
CHUNKS = 20
"""Number of chunks into which the sampled time is divided; their means show a drift. If the wall
time is limited, the first chunks are a 32nd as long; whenever there are 2 ``CHUNKS``, they are
joined in pairs."""
FALSE_ALARMS = 1e-6
"""Probability that a correct simulation fails one test: a comparison, or the test for a drift of
all quantities. A verification makes thousands of comparisons, and one alarm is an error."""


def moment_products(n: int, *, terms: bool = False) -> tuple[Product, ...]:
    """Return the products that a simulation of ``n`` masses sums, in the order of its sums.

    p_i p_j (i <= j), q_i p_j, and of each mass q f, p f, q q; with damping ``terms`` c̃ also p d
    and q d. The forces are f = K q + g(q) and d_i = Σ_j c̃_ij v_j.
    """
    masses = range(n)
    products: list[Product] = [("p", i, "p", j) for i in masses for j in range(i, n)]
    products += [("q", i, "p", j) for i in masses for j in masses]
    for a, b in ("qf", "pf", "qq", *(("pd", "qd") if terms else ())):
        products += [(a, i, b, i) for i in masses]
    return tuple(products)


def moment_identities(system: System, batch_means: Array) -> tuple[Identity, ...]:
    """Return the moment identities, which are exact in the stationary state of Eq. (6).

    The generator applied to H, q_i p_i and p_i² has mean zero:
    ``Σ_ij c_ij E v_i v_j = Σ_i N_ii/m_i``; ``m_i E v_i² = E q_i F_i + Σ_j c_ij E q_i v_j``;
    ``E p_i F_i + Σ_j c_ij E p_i v_j = N_ii``; F = K q + g(q), N = f D fᵀ. Damping terms are part of
    c, inside the means. Standard errors come from the spread of ``batch_means`` (batches,
    products), in the order of ``moment_products``.
    """
    m, c, masses = system.mass, system.damping, range(system.n)
    products = moment_products(system.n, terms=bool(system.damping_terms))
    mean = dict(zip(products, batch_means.T, strict=True))
    mean |= {(b, j, a, i): own for (a, i, b, j), own in mean.items()}

    def damped(a: str, i: int) -> Array:
        terms = [c[i, j] / m[j] * mean[a, i, "p", j] for j in masses]
        return np.asarray(np.sum(terms, axis=0) + mean.get((a, i, "d", i), 0.0))

    noise = np.diag(system.noise_matrix)
    loss = np.sum([damped("p", i) / m[i] for i in masses], axis=0)
    sides = [("energy balance", loss, float(np.sum(noise / m)))]
    for i in masses:
        virial = mean["p", i, "p", i] / m[i] - mean["q", i, "f", i] - damped("q", i)
        work = mean["p", i, "f", i] + damped("p", i)
        sides.append((f"virial of mass {i + 1}", virial, 0.0))
        sides.append((f"kinetic balance of mass {i + 1}", work, float(noise[i])))
    return tuple(
        Identity(name, float(left.mean()), right, float(left.std(ddof=1) / np.sqrt(left.size)))
        for name, left, right in sides
    )


def l1_difference(a: SampledDensity, b: SampledDensity) -> Number:
    """Return ∫|p_a − p_b| of two independent samples ``a``, ``b`` on the same bins.

    ``error`` is the mean of this distance by chance, for two samples of one density. To reduce the
    noise bins are joined first, to about 128 on an axis, 64 for a pair of coordinates.
    """
    bins = 128 if len(a.edges) == 1 else 64
    a, b = (density.joined(min(density.values.shape) // bins) for density in (a, b))
    spread = float(np.sum(np.hypot(a.standard_error, b.standard_error)))
    area = float(np.prod([e[1] - e[0] for e in a.edges]))
    return Number(l1_distance(a, b), sqrt(2.0 / pi) * area * spread)


@dataclass(frozen=True)
class Diagnosis:
    """Tests of a sample; ``failures``: in words why it is not certified, else empty.

    ``autocorrelation_time`` τ, in the system's unit of time, is the longest of all quantities, and
    ``slowest`` the name of this quantity, which has ``effective_samples``, known to a
    ``relative_error``. Each trajectory is sampled for ``times_per_path`` τ. ``r_hat`` is the
    largest split R-hat (NaN for fewer than four chunks), ``drift`` the largest |z| of ``drifts``
    (0 for a single chunk), and ``drift_limit`` its largest value by chance.
    """

    autocorrelation_time: float
    effective_samples: float
    relative_error: float
    slowest: str
    times_per_path: float
    r_hat: float
    drift: float
    drift_limit: float
    failures: tuple[str, ...]


def effective_of_paths(means: Array, variance: Array, relative_error: Array) -> tuple[Array, Array]:
    """Return the effective samples N σ²/var(means) of quantities, and their relative errors.

    Both are (quantities,). ``means`` (quantities, N): averages over each of N trajectories;
    ``variance`` (quantities,): σ² of single samples, known to ``relative_error`` (quantities,).
    Effective samples are inf if all means of a quantity are equal.
    """
    of_means = means.var(axis=1, ddof=1)
    samples = np.full_like(of_means, inf)
    np.divide(means.shape[1] * variance, of_means, out=samples, where=of_means > 0)
    return samples, np.hypot(variance_error(means), relative_error)


def effective_of_shares(shares: Array) -> tuple[float, float]:
    """Return the effective samples of one quantity in all batches, and their relative error.

    ``shares`` (batches, levels) of samples are below fixed levels, in two or more batches of equal
    size. The effective samples are inf if no share varies.
    """
    # n samples have variances of sum Σ s(1 − s)/n. Levels are correlated: the error is for one.
    batches, s = shares.shape[0], shares.mean(axis=0)
    variance = float(np.sum(shares.var(axis=0, ddof=1))) / batches
    samples = float(np.sum(s * (1.0 - s))) / variance if variance > 0 else inf
    return samples, sqrt(2.0 / (batches - 1))


def variance_error(samples: Array) -> Array:
    """Return √((kurtosis − 1)/N), relative error of the variance of N ``samples``; 0 if equal."""
    away = samples - samples.mean(axis=-1, keepdims=True)
    size = np.max(np.abs(away), axis=-1, keepdims=True)
    # In units of the largest deviation, so that no fourth power overflows.
    squares = np.divide(away, size, out=np.zeros_like(away), where=size > 0) ** 2
    second = np.mean(squares, axis=-1)
    # kurtosis − 1 as a variance is never negative.
    excess = np.divide(squares.var(axis=-1), second**2, out=np.zeros_like(second), where=second > 0)
    return np.asarray(np.sqrt(excess / samples.shape[-1]))


def split_r_hat(draws: Array) -> float:
    """Return the split R-hat of ``draws`` (chains, draws); NaN for fewer than four in a chain.

    Each chain is divided into halves of n draws: ``R = √((n − 1)/n + B/(n W))``, W the mean of the
    variances, B n times the variance of the means (Gelman et al., BDA3, section 11.4). If W is 0,
    R is 1 for equal means, else inf. The middle draw of an odd number is left out.
    """
    half = draws.shape[1] // 2
    if half < 2:
        return nan
    halves = np.vstack([draws[:, :half], draws[:, -half:]])
    within = float(halves.var(axis=1, ddof=1).mean())
    between = half * float(halves.mean(axis=1).var(ddof=1))
    if within == 0.0:
        return 1.0 if between == 0.0 else inf
    return sqrt((half - 1.0) / half + between / (half * within))


def drifts(means: Array) -> Array:
    """Return z = mean/(standard error) over batches of two differences, (quantities, 2).

    They are the first chunk minus the mean of the others, and the first half of the chunks minus
    the second half. ``means`` (quantities, batches, chunks), two chunks or more. z is 0 if a
    difference does not vary.
    """
    half = means.shape[2] // 2
    first, others = means[:, :, 0], means[:, :, 1:].mean(axis=2)
    early, late = means[:, :, :half].mean(axis=2), means[:, :, -half:].mean(axis=2)
    difference = np.stack([first - others, early - late])
    error = difference.std(axis=2, ddof=1) / sqrt(means.shape[1])
    moved = difference.mean(axis=2)
    return np.asarray(np.divide(moved, error, out=np.zeros_like(moved), where=error > 0).T)


def octiles(below: Integers) -> Integers:
    """Return the ascending numbers of the bins that contain the seven octiles, without repeats.

    ``below`` (bins,): samples below the upper end of each bin; a bin with all of them is left out.
    """
    cuts = np.unique(np.searchsorted(8 * below, np.arange(1, 8) * int(below[-1])))
    # Without cuts below which all or no samples lie.
    return np.asarray(cuts[(below[cuts] > 0) & (below[cuts] < below[-1])], dtype=np.int64)


def largest_by_chance(batches: int, comparisons: int, *, sides: int = 2) -> float:
    """Return the |z| that the largest of ``comparisons`` exceeds with probability ``FALSE_ALARMS``.

    z is Student's t of ``batches`` − 1 degrees of freedom; of one of its ``sides`` z itself.
    """
    return -float(stdtrit(batches - 1, FALSE_ALARMS / (sides * max(1, comparisons))))


def diagnosis(
    effective: Sequence[tuple[str, float, float]],
    names: Sequence[str],
    means: Array,
    *,
    time: float,
    paths: int,
    burn_in: float,
) -> Diagnosis:
    """Return the diagnosis of ``paths`` trajectories, each sampled for ``time`` after ``burn_in``.

    ``effective``: name, effective samples of all trajectories and their relative error, for each
    quantity; τ follows from the least. ``means`` (quantities, batches, chunks) have the ``names``.
    """
    slowest, samples, relative_error = min(effective, key=lambda e: e[1])
    tau = paths * time / (2.0 * samples) if samples > 0 else inf
    quantities, batches, chunks = means.shape
    z = np.abs(drifts(means)) if chunks > 1 else np.zeros((quantities, 2))
    drift, limit = float(z.max()), largest_by_chance(batches, z.size)
    failures = list[str]()
    if chunks < 2:
        failures.append("it ended in its first chunk, where no drift shows; sample for longer")
    if samples < LEAST_TIMES:
        failures.append(
            f"the {paths} trajectories are {samples:.3g} autocorrelation times of"
            f" {slowest} long together, fewer than {LEAST_TIMES:g}; sample for longer"
        )
    if burn_in < LEAST_BURN_IN * tau:
        failures.append(
            f"the burn-in of {burn_in:.3g} is shorter than {LEAST_BURN_IN:g} autocorrelation times"
            f" of {tau:.3g}; use a longer burn_in"
        )
    if drift > limit:
        failures.append(
            f"{names[int(np.argmax(z.max(axis=1)))]} drifts: its first part differs from the rest"
            f" by {drift:.1f} standard errors (chance explains {limit:.1f}); use a longer burn_in"
        )
    length, r_hat = time / tau if tau > 0 else inf, max(map(split_r_hat, means))
    known = tau, samples, relative_error, slowest, length, r_hat, drift, limit
    return Diagnosis(*known, failures=tuple(failures))


@dataclass(frozen=True)
class Report:
    """Settings and results of a simulation, without the densities; times in the system's unit.

    ``dt`` is the step of the integrator; ``paths`` were sampled for ``time`` after ``burn_in``, in
    ``steps`` of ``long_step``, every ``stride``-th of them observed. ``relaxation_time`` is the
    longest decay time without contact. ``small_steps``: words on which trajectories make small
    steps; ``limited_by``: the setting that cut ``time`` short, else empty. ``kT`` is the
    ``temperature`` of the system; ``ns_per_particle_step`` is processor time in ns.

    ``diagnosis`` is None if Ctrl-C ended the sampling (words in ``interrupted``), or the limit of
    time in the first chunk. ``moments`` are means over the sampled states by name, such as ``q2²``,
    with one standard error. ``step_pair``: words on the comparison with a second simulation at half
    the step; ``step_biases`` are the differences by the names of densities, such as ``q2,p2`` (L1
    distances; their error is the mean value by chance alone), and of moments (with standard
    errors). With weak order w they are ``1 − 2^−w`` times the bias at dt.
    """

    dt: float
    paths: int
    time: float
    burn_in: float
    relaxation_time: float
    scheme: str
    steps: int
    stride: int
    batches: int
    seed: int
    threads: int
    kT: float
    long_step: float
    ns_per_particle_step: float
    small_steps: str
    limited_by: Literal["", "most_steps"]
    diagnosis: Diagnosis | None = None
    moments: Mapping[str, Number] = field(default_factory=dict)
    interrupted: str = ""
    step_pair: str = "not measured"
    step_biases: Mapping[str, Number] = field(default_factory=dict)

    def settings(self, densities: Sequence[AnyDensity]) -> dict[str, str | float | int]:
        """Return report and L1 errors of ``densities`` in one dictionary, by names in tables.

        Keys are the fields before ``diagnosis`` whose words are not empty, and words such as
        "r_hat", "sampling error of q2", "E q2²" and "step bias of E q2²", if there are any.
        """
        of_run = takewhile(lambda f: f.name != "diagnosis", fields(self))
        settings = {f.name: own for f in of_run if (own := getattr(self, f.name)) != ""}
        if self.interrupted:
            settings["partial"] = self.interrupted
        if d := self.diagnosis:
            verdict = "holds" if d.drift <= d.drift_limit else "drifts"
            settings |= {
                "autocorrelation_time": d.autocorrelation_time,
                "time in autocorrelation times": d.times_per_path,
                "effective_samples": d.effective_samples,
                "relative error of effective_samples": d.relative_error,
                "slowest quantity": d.slowest,
                "r_hat": d.r_hat,
                "burn_in_check": f"{verdict}: |z| = {d.drift:.2f}, allowed {d.drift_limit:.2f}",
            }
        settings |= {f"sampling error of {d.name}": d.l1_error for d in densities}
        if densities:
            words = "expected L1 error of the density as it is returned at points"
            settings["sampling error"] = f"{words}; tol is of the same"
        for name, mean in self.moments.items():
            settings |= {f"E {name}": mean.value, f"standard error of E {name}": mean.error}
        settings["step bias"] = self.step_pair
        rows = [(d.name, d.name, "{} by chance") for d in densities]
        rows += [(name, f"E {name}", "standard error of {}") for name in self.moments]
        for key, label, chance in rows:
            if bias := self.step_biases.get(key):
                name = f"step bias of {label}"
                settings |= {name: bias.value, chance.format(name): bias.error}
        return settings
