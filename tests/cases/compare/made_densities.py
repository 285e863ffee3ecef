"""Densities of q1 that are known beforehand: Gaussian, uniform, and histograms of samples."""

import numpy as np

from fpk.answer.bins import BinAxis
from fpk.answer.certificate import Certificate
from fpk.answer.density import Density
from fpk.answer.names import parse_observable
from fpk.answer.sampled_density import SampledDensity

CERTIFIED = Certificate(0.0, 0.0, 0.0, 0.0, 0.0)
Q1 = parse_observable("q1", 1)


def density_of(pdf, reach, l1_error=1e-12):
    nodes = np.linspace(-reach, reach, 61)
    return Density(Q1, (nodes,), pdf, lambda x: np.full_like(x, 1e-13), l1_error, CERTIFIED)


def gaussian(scale=1.0, l1_error=1e-12):
    def pdf(x):
        return np.exp(-0.5 * (x / scale) ** 2) / (scale * np.sqrt(2 * np.pi))

    return density_of(pdf, 9 * scale, l1_error)


def uniform():
    return density_of(lambda x: np.where(np.abs(x) <= 1, 0.5, 0.0), 1.0)


def histogram(seed=5, *, size=20_000, bins=240, draw=lambda rng, n: rng.normal(size=n)):
    """Of 32 batches of ``size`` numbers."""
    rng, edges = np.random.default_rng(seed), np.linspace(-6, 6, bins + 1)
    counts = np.array([np.histogram(draw(rng, size), edges)[0] for _ in range(32)])
    values = counts / size / (edges[1] - edges[0])
    return SampledDensity(Q1, (BinAxis(edges),), values.mean(0), values, CERTIFIED)
