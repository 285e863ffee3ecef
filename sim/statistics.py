"""Means with standard errors from independent batches, and the identities that they must meet."""

from math import pi, sqrt

import numpy as np

from fpk.arrays import Array
from fpk.density import l1_distance
from fpk.method import Identity
from fpk.sampled_density import SampledDensity
from fpk.system import System

Product = tuple[str, int, str, int]
"""Two coordinates whose product is summed, each a kind (q, p, f or d) and a mass from 0."""

L1_BINS = (128, 64)
"""Bins of each axis, of one and of two coordinates, on which two samples are compared. On the bins
of the histogram itself it would show the counting noise of each, which any smoothing removes."""


def moment_products(n: int, *, terms: bool = False) -> tuple[Product, ...]:
    """Return the products that are summed: p p, q p, q F, p F and q q, F = K q + g(q).

    With damping ``terms`` of the forces D_i = Σ_j c̃_ij v_j also p D and q D.
    """
    masses = range(n)
    products: list[Product] = [("p", i, "p", j) for i in masses for j in range(i, n)]
    products += [("q", i, "p", j) for i in masses for j in masses]
    for a, b in ("qf", "pf", "qq", *(("pd", "qd") if terms else ())):
        products += [(a, i, b, i) for i in masses]
    return tuple(products)


def batch_moments(system: System, batch_means: Array) -> dict[Product, Array]:
    """Return the mean (batches,) of each product, in either order, from (batches, products)."""
    products = moment_products(system.n, terms=bool(system.damping_terms))
    moments = dict(zip(products, batch_means.T, strict=True))
    return moments | {(b, j, a, i): mean for (a, i, b, j), mean in moments.items()}


def moment_identities(system: System, batch_means: Array) -> tuple[Identity, ...]:
    """Return the moment identities, exact in the stationary state of Eq. (6).

    The generator applied to H, q_i p_i and p_i² has mean zero:
    ``Σ_ij c_ij E v_i v_j = Σ_i N_ii/m_i``; ``m_i E v_i² = E q_i F_i + Σ_j c_ij E q_i v_j``;
    ``E p_i F_i + Σ_j c_ij E p_i v_j = N_ii``; N = f D fᵀ and F = K q + g(q). Damping terms are
    part of c, inside the means. ``batch_means`` (batches, products): errors are from their spread.
    """
    m, c, masses = system.mass, system.damping, range(system.n)
    mean = batch_moments(system, batch_means)

    def damped(a: str, i: int) -> Array:
        terms = [c[i, j] / m[j] * mean[a, i, "p", j] for j in masses]
        if system.damping_terms:
            terms.append(mean[a, i, "d", i])
        return np.asarray(np.sum(terms, axis=0))

    noise = np.diag(system.noise_matrix)
    loss = np.sum([damped("p", i) / m[i] for i in masses], axis=0)
    identities = [_identity("energy balance", loss, float(np.sum(noise / m)))]
    for i in masses:
        virial = mean["p", i, "p", i] / m[i] - mean["q", i, "f", i] - damped("q", i)
        identities.append(_identity(f"virial of mass {i + 1}", virial, 0.0))
        work = mean["p", i, "f", i] + damped("p", i)
        identities.append(_identity(f"kinetic balance of mass {i + 1}", work, float(noise[i])))
    return tuple(identities)


def _identity(name: str, batches: Array, expected: float) -> Identity:
    error = float(batches.std(ddof=1) / np.sqrt(batches.size))
    return Identity(name, float(batches.mean()), expected, error)


def l1_difference(a: SampledDensity, b: SampledDensity) -> tuple[float, float]:
    """Return ∫|p_a − p_b| of two independent samples on the same bins, joined to ``L1_BINS``.

    The second number is its expectation were both densities the same and none of either outside.
    """
    wanted = L1_BINS[len(a.edges) - 1]
    a, b = (density.joined(min(density.values.shape) // wanted) for density in (a, b))
    spread = float(np.sum(np.hypot(a.standard_error, b.standard_error)))
    area = float(np.prod([e[1] - e[0] for e in a.edges]))
    return l1_distance(a, b), sqrt(2.0 / pi) * area * spread
