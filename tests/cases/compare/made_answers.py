"""Densities that are known beforehand, and methods that answer wrongly or not at all."""

from dataclasses import dataclass, replace

import numpy as np

from averaging.nonintegrable import NonIntegrable
from averaging.theory import Exact
from fpk.answer.bins import BinAxis
from fpk.answer.certificate import Certificate, Measured
from fpk.answer.density import Density, certify_density
from fpk.answer.method import Plan
from fpk.answer.names import parse_observable
from fpk.answer.sampled_density import SampledDensity


def displaced(system):
    """The system with its stops ten percent too far."""
    contacts = tuple(replace(c, clearance=1.1 * c.clearance) for c in system.contacts)
    return replace(system, contacts=contacts)


class DisplacedAveraging(NonIntegrable):
    """The theory of another system."""

    def prepare(self, system):
        return super().prepare(displaced(system))


def restated(plan, shift, floor, tol):
    """The plan whose densities are moved by ``shift`` and state an error of ``floor`` or more."""

    def stated(d):
        return certify_density(
            d.observable,
            tuple(nodes + shift for nodes in d.panels),
            lambda x, *p: d.pdf(x - shift, *p),
            lambda x, *p: d.pointwise(x - shift, *p),
            measured=Measured(max(floor, d.l1_error), 0.0, 0.0, 0.0, 0.0),
            tol=tol,
        )

    def solve(observables, progress):
        result = plan.solve(observables, progress)
        return replace(result, densities=tuple(map(stated, result.densities)))

    return Plan(plan.refusal, solve)


@dataclass(frozen=True)
class Shifted(Exact):
    """The exact density moved by 0.1, its error stated as if it were right.

    ``judged_by`` is the tolerance of the moved answer.
    """

    judged_by: float = 1e-6

    def prepare(self, system):
        return restated(super().prepare(system), 0.1, 0.0, self.judged_by)


@dataclass(frozen=True)
class Coarse(NonIntegrable):
    """Finite elements whose stated error is never below ``floor``, of a shifted density."""

    floor: float = 1.2e-10
    shift: float = 0.0

    def prepare(self, system):
        return restated(super().prepare(system), self.shift, self.floor, self.tol_for(system))


@dataclass(frozen=True)
class Interrupting(NonIntegrable):
    """Presses Ctrl-C while it solves."""

    def prepare(self, system):
        def solve(observables, progress):
            raise KeyboardInterrupt

        return Plan(lambda observable: None, solve)


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
