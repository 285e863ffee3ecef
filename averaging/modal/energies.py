"""Densities of the modal energies and of their sum in closed form, Eq. (34)."""

from collections.abc import Callable, Mapping
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from fpk.certificate import Certificate
from fpk.density import Density
from fpk.observable import Observable

Array = NDArray[np.float64]
Provenance = Mapping[str, str | float | int]

REACH = 40.0
"""Nats kept of an exponential: 4e-18 of the mass lies beyond."""
PANELS = 20
TAYLOR_TERMS = 20
"""Terms of an exponential series of an argument up to 1: the rest is 1/20! = 4e-19."""
EPS = float(np.finfo(float).eps)


def modal_energies(
    temperature: Array, observable: Observable, *, relative: float, provenance: Provenance
) -> Density:
    """Return p(H_i) or p(H_i, H_j) of (34), a product of exponentials of means θ_i.

    In (34) as corrected the exponent is −c*_ii H_i/d_i = −H_i/θ_i. ``temperature`` holds the θ of
    the observed modes, ``relative`` their relative error: d(e^(−H/θ)/θ) is (H/θ − 1) dθ/θ of it,
    2/e dθ/θ in L1.
    """
    panels = tuple(np.linspace(0.0, REACH * theta, PANELS + 1) for theta in temperature)
    norm = float(np.prod(temperature))

    def exponent(*energies: Array) -> Array:
        pairs = zip(energies, temperature, strict=True)
        return np.asarray(sum(np.asarray(H, dtype=float) / theta for H, theta in pairs))

    def pdf(*energies: Array) -> Array:
        least = reduce(np.minimum, energies)
        return np.where(least >= 0.0, np.exp(-exponent(*map(np.abs, energies))) / norm, 0.0)

    def pointwise(*energies: Array) -> Array:
        x = exponent(*energies)
        return np.asarray((relative * (x + temperature.size) + EPS * (x + 4.0)) * pdf(*energies))

    tail = temperature.size * float(np.exp(-REACH))
    error = temperature.size * (relative + 4.0 * EPS)
    return _closed_form(observable, panels, pdf, pointwise, error, tail, provenance)


def total_energy(
    temperature: Array, observable: Observable, *, relative: float, provenance: Provenance
) -> Density:
    """Return p(H) of H = Σ H_i from (34): the hypoexponential density, stable for all θ_i."""
    if temperature.size == 1:
        return modal_energies(temperature, observable, relative=relative, provenance=provenance)
    rates = 1.0 / np.sort(temperature)[::-1]

    def pdf(energy: Array) -> Array:
        return hypoexponential(rates, np.asarray(energy, dtype=float))

    def pointwise(energy: Array) -> Array:
        # d ln p/d ln θ_i lies between −1 and H/θ_i, the range of H_i/θ_i − 1 below H.
        x = np.asarray(energy, dtype=float)
        size = np.sum(1.0 + np.multiply.outer(x, rates), axis=-1)
        return np.asarray((relative * size + _chain_round_off(rates, x)) * pdf(energy))

    end = _end(temperature)
    nodes = _nodes(float(np.min(temperature)), float(np.max(temperature)), end)
    error = temperature.size * relative + float(np.max(_chain_round_off(rates, nodes)))
    tail = float(np.exp(-REACH))
    return _closed_form(observable, (nodes,), pdf, pointwise, error, tail, provenance)


def hypoexponential(rates: Array, energy: Array) -> Array:
    """Density of a sum of independent exponentials of the given rates, at energies of any shape.

    It is λ_n (e^(N H))_1n with N_ii = −λ_i, N_i,i+1 = λ_i, a chain of n stages. The textbook sum
    over 1/(λ_i − λ_j) cancels for nearly equal rates. Here, the exponential of a small step is a
    Taylor series of N + λ_max, which has no negative entry, and is squared with its diagonal
    known (Al-Mohy and Higham, SIAM J. Matrix Anal. Appl. 31 (2009) 970): all terms are positive,
    every digit is kept for equal rates as for different ones.
    """
    x = energy.ravel()
    n, fastest = rates.size, float(np.max(rates))
    squarings = _squarings(rates, x)
    step = np.maximum(x, 0.0) / 2.0**squarings
    positive = np.diag(fastest - rates) + np.diag(rates[:-1], 1)
    term = np.broadcast_to(np.eye(n), (x.size, n, n)).copy()
    E = term.copy()
    for k in range(1, TAYLOR_TERMS + 1):
        term = (term @ positive) * (step / k)[:, None, None]
        E += term
    E *= np.exp(-fastest * step)[:, None, None]
    diagonal = np.arange(n)
    for _ in range(squarings):
        step = 2.0 * step
        E = E @ E
        E[:, diagonal, diagonal] = np.exp(-np.multiply.outer(step, rates))
    return np.where(x >= 0.0, rates[-1] * E[:, 0, -1], 0.0).reshape(energy.shape)


def _squarings(rates: Array, energy: Array) -> int:
    reach = float(np.max(rates)) * float(np.max(energy, initial=0.0))
    return max(int(np.ceil(np.log2(max(reach, 1.0)))), 0)


def _chain_round_off(rates: Array, energy: Array) -> Array:
    """Relative round-off of ``hypoexponential``: n ε of every product of matrices, n in a row.

    With the diagonal exact, each squaring adds n ε to an entry (1, m) beside at most m entries of
    the row before; and e^(−λH) has the relative error λH ε.
    """
    n = rates.size
    products = TAYLOR_TERMS + _squarings(rates, energy)
    return np.asarray(EPS * (n * n * products + np.asarray(energy) * np.min(rates)))


def _end(temperature: Array) -> float:
    """Energy beyond which less than e^(−REACH) lies, by Chernoff's bound at 7/8 of the least rate.

    P(ΣH_i > E) <= e^(−sE) Π 1/(1 − s θ_i).
    """
    largest = float(np.max(temperature))
    s = 0.875 / largest
    return float((REACH - np.sum(np.log1p(-s * temperature))) / s)


def _nodes(least: float, largest: float, end: float) -> Array:
    """Panels of two means of the fastest mode at H = 0, growing to two means of the slowest."""
    nodes = [0.0]
    while nodes[-1] < end:
        nodes.append(nodes[-1] + min(max(2.0 * least, nodes[-1] / 3.0), 2.0 * largest))
    return np.array([*nodes[:-1], end])


def _closed_form(
    observable: Observable,
    panels: tuple[Array, ...],
    pdf: Callable[..., Array],
    pointwise: Callable[..., Array],
    error: float,
    tail: float,
    provenance: Provenance,
) -> Density:
    certificate = Certificate(mass_defect=error, minimum=0.0, residual=0.0, tail_mass=tail)
    return Density(observable, panels, pdf, pointwise, error + tail, certificate, provenance)
