"""The density of the full system that averaged theories are held against at a point of a grid."""

from contextlib import suppress

from cases.comparison.routes import method_for
from cases.studies.simulation import best_answer, deterministic
from fpk.density import AnyDensity
from fpk.errors import NotApplicable
from fpk.method import Method
from fpk.observable import Observable
from fpk.system import System
from sim.montecarlo import MonteCarlo

SIMULATION = MonteCarlo(relaxations=38.0)
"""Simulation of a point: with 38 relaxation times a path the sampling error of the L1 distance of
one displacement is about 0.001."""
REFERENCE_TOL = 2e-4
"""L1 error wanted of a reference that is not sampled: a fifth of what the simulation leaves."""
SHARE = 3.5
"""Work that such a reference may take, over what it takes unasked elsewhere: a minute."""


def solver_of(reference: str) -> Method | None:
    """Return the method named ``reference`` to ``REFERENCE_TOL``, None where it is the simulation.

    Raises ``InvalidInput`` for a reference that is no method.
    """
    simulated = reference == SIMULATION.route.method
    return None if simulated else method_for(reference, tol=REFERENCE_TOL)


def reference_of(
    system: System,
    observable: Observable,
    solver: Method | None,
    simulation: MonteCarlo,
    problems: list[str],
) -> tuple[str, AnyDensity] | None:
    """Return the label and density of the reference: the full system's exact one if there is one.

    Else that of ``solver``, if it is given and certifies its answer, as far as it works unasked;
    else that of ``simulation``. None without one; ``problems`` as of ``best_answer``.
    """
    reference = best_answer(deterministic("full"), system, observable, problems)
    if reference is None and solver is not None:
        with suppress(NotApplicable):
            reference = best_answer([solver.unasked(system, share=SHARE)], system, observable, [])
        if reference is not None and not reference[1].certificate.certified:
            reference = None
    return reference or best_answer([simulation], system, observable, problems)
