"""Means with standard errors from independent batches, and the identities that they must meet."""

from dataclasses import dataclass
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


@dataclass(frozen=True, eq=False)
class Moments:
    """Stationary second moments of each batch; any linear function of them has its error."""

    system: System
    batch_means: Array  # (batches, products)

    def batches(self, a: str, i: int, b: str, j: int) -> Array:
        """Return the mean (batches,) of one product in each batch, masses counted from 0."""
        products = moment_products(self.system.n, terms=bool(self.system.damping_terms))
        key = (a, i, b, j) if (a, i, b, j) in products else (b, j, a, i)
        return np.asarray(self.batch_means[:, products.index(key)])

    def identities(self) -> tuple[Identity, ...]:
        """Return the moment identities, exact in the stationary state of Eq. (6).

        The generator applied to H, q_i p_i and p_i² has mean zero:
        ``Σ_ij c_ij E v_i v_j = Σ_i N_ii/m_i``; ``m_i E v_i² = E q_i F_i + Σ_j c_ij E q_i v_j``;
        ``E p_i F_i + Σ_j c_ij E p_i v_j = N_ii``; N = f D fᵀ and F = K q + g(q). Damping terms are
        part of c, inside the means.
        """
        system, m, c = self.system, self.system.mass, self.system.damping
        masses = range(system.n)

        def damped(a: str, i: int) -> Array:
            terms = [c[i, j] / m[j] * self.batches(a, i, "p", j) for j in masses]
            if system.damping_terms:
                terms.append(self.batches(a, i, "d", i))
            return np.asarray(np.sum(terms, axis=0))

        noise = np.diag(system.noise_matrix)
        loss = np.sum([damped("p", i) / m[i] for i in masses], axis=0)
        identities = [_identity("energy balance", loss, float(np.sum(noise / m)))]
        for i in masses:
            kinetic = self.batches("p", i, "p", i) / m[i]
            virial = kinetic - self.batches("q", i, "f", i) - damped("q", i)
            identities.append(_identity(f"virial of mass {i + 1}", virial, 0.0))
            work = self.batches("p", i, "f", i) + damped("p", i)
            identities.append(_identity(f"kinetic balance of mass {i + 1}", work, float(noise[i])))
        return tuple(identities)


def _identity(name: str, batches: Array, expected: float) -> Identity:
    error = float(batches.std(ddof=1) / np.sqrt(batches.size))
    return Identity(name, float(batches.mean()), expected, error)


def sampling_error(density: SampledDensity) -> float:
    """Return the expected ∫|p − p_exact| of the density as ``density.at`` returns it at points.

    √(2/π) standard errors, integrated: the expectation of |x| of a normal x.
    """
    middles = (0.5 * (e[1:] + e[:-1]) for e in density.edges)
    error = density.at(*np.meshgrid(*middles, indexing="ij", sparse=True))[1]
    return sqrt(2.0 / pi) * _bin_area(density) * float(np.sum(error))


def l1_difference(a: SampledDensity, b: SampledDensity) -> tuple[float, float]:
    """Return ∫|p_a − p_b| of two independent samples on the same bins, joined to ``L1_BINS``.

    The second number is its expectation were both densities the same and none of either outside.
    """
    wanted = L1_BINS[len(a.edges) - 1]
    a, b = (density.joined(min(density.values.shape) // wanted) for density in (a, b))
    spread = float(np.sum(np.hypot(a.standard_error, b.standard_error)))
    return l1_distance(a, b), sqrt(2.0 / pi) * _bin_area(a) * spread


def _bin_area(density: SampledDensity) -> float:
    return float(np.prod([e[1] - e[0] for e in density.edges]))
