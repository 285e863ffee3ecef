"""Methods that answer wrongly or not at all: what a run has to say of them."""

from dataclasses import dataclass, replace

from averaging.nonintegrable import NonIntegrable
from averaging.theory import Exact
from fpk.answer.certificate import Measured
from fpk.answer.density import certify_density
from fpk.answer.method import Plan


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
