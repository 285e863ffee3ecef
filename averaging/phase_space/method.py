"""Method ``phase-space``: the stationary FPK equation of the full system (6), deterministic."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from math import inf
from typing import Self

import numpy as np

from averaging.gaussian import Linear
from averaging.phase_space import dynamics
from averaging.phase_space.densities import expansion_density, expansion_settings, identities
from averaging.phase_space.equation.basis import basis
from averaging.phase_space.equation.degrees import first_degrees, next_degrees
from averaging.phase_space.equation.elimination import solution_cost
from averaging.phase_space.equation.frame import Frame, contact_frame, gibbs_reference
from averaging.phase_space.plane.dynamics import uniform_ladder
from averaging.phase_space.plane.first_passage import phase_space_passage
from averaging.phase_space.plane.oscillator import oscillator_of, require_broad
from averaging.phase_space.plane.stationary import plane_ladder, plane_ladder_of
from averaging.phase_space.plane.transient import plane_transient
from averaging.phase_space.refinement import (
    HOPELESS,
    SOLUTION_MEMORY,
    SOLUTION_WORK,
    Ladder,
    Options,
    better,
    breakdowns,
    ladder_of,
    solution_ladder,
)
from averaging.theory import LARGEST, Exact, Theory
from fpk.answer.certificate import Measured, certify
from fpk.answer.dynamics import Curve, Passage, Rates, Transient, certify_curve
from fpk.answer.method import Plan, Progress, Result, silent
from fpk.answer.names import Coordinate, Observable, observable_name
from fpk.answer.question import Asked, answer
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.system.escape import require_held
from fpk.system.system import System

MOST_EXPANSION_MASSES = 3
"""Largest number of masses; for more even the lowest useful degrees exceed the memory."""
UNASKED_MASSES = 2
"""Largest number of masses for which the method is used without being named: three take minutes."""
UNASKED_WORK = 6.6e11
"""Largest number of operations (``solution_cost``) of a solution without being named: with the
coarser solutions about half a minute on one core."""
CROSSINGS_TOL, SPECTRUM_TOL, CORRELATION_TOL, RELAXATION_TOL = 1e-3, 1e-2, 1e-2, 5e-2
"""Default tolerances, relative to ``Question.scale``, of rates to each rate; spectra and rates
converge most slowly."""


@dataclass(frozen=True)
class PhaseSpace(Theory):
    """Densities of displacements and momenta from the FPK equation of Eq. (6) itself.

    The equation of one mass is solved by finite elements in the plane of displacement and velocity
    (``averaging.phase_space.plane``), with any damping terms. For two or three masses, with stops
    on one, the density is expanded in polynomials on panels of its displacement and in Hermite
    functions of all velocities and other displacements, and the equations are solved by elimination
    of levels of equal degree (``averaging.phase_space.equation``), with damping terms as far as
    memory and work allow.

    ``tol`` is the L1 tolerance of each density: meshes are refined, or degrees rise, until the
    estimated error meets it, or until memory, work or the highest degree ends the refinement, which
    the certificate then says.
    ``accepted`` is the largest error that is certified in that case, and ``NotCertified`` is raised
    for a larger error; None: ``tol``, and the certificate of a larger error fails. ``memory``
    limits one solution, in GB, ``work`` its operations, None: by the memory, about five minutes on
    a core for 4 GB. ``threads`` are for linear algebra, None: all cores; if other processes
    use these, the threads wait for each other and take ten times as long. ::

        fpk.solve(system, ["q2", "q2,p2"], methods=[PhaseSpace(tol=1e-3)])

    Crossings, spectrum, autocovariance, rates, density in time and first passage of one mass::

        stop = fpk.Contact(mass=1, side="both", stiffness=4.0, clearance=0.5)
        one = fpk.System([1.0], [1.0], [0.6], [0.3], contacts=(stop,))
        PhaseSpace().crossings(one, parse_observable("q1", 1), np.array([0.0, 0.5])).values
        PhaseSpace().spectrum(one, parse_observable("q1", 1), np.linspace(0.0, 2.0, 5)).values
        PhaseSpace().correlation(one, parse_observable("q1", 1), np.linspace(0.0, 5.0, 5)).values
        PhaseSpace().relaxation(one, 2).values
        q1, at = parse_observable("q1", 1), (np.array([0.0, 0.5]),)
        PhaseSpace(tol=1e-3).transient(one, q1, REST, np.array([2.0, 10.0]), at).values
        PhaseSpace().passage(one, parse_limit("q1=1", 1), REST, np.array([10.0])).mean
    """

    solver: str = "hermite"
    tol: float = 1e-4
    accepted: float | None = None
    memory: float = SOLUTION_MEMORY
    work: float | None = None
    threads: int | None = None
    method = "phase-space"
    solvers = (("hermite", "full FPK equation", "(6)"),)
    colour = "#5e02e0"

    def __post_init__(self) -> None:
        """Raise ``InvalidInput`` as ``Theory`` does, and unless 0 < ``memory`` < ∞."""
        super().__post_init__()
        if not 0.0 < self.memory < inf:
            raise InvalidInput("memory", self.memory, "use a positive number of GB")

    def unasked(self, system: System, *, share: float = 1.0) -> Self:
        """Return a copy limited to work of seconds, ``share`` of ``UNASKED_WORK``.

        Its ``accepted`` is at least 0.01, and it uses one thread if ``threads`` is None. Raises
        ``NotApplicable`` for more than ``UNASKED_MASSES`` masses, for damping terms, for systems
        that ``Exact`` or ``Linear`` solves, and as ``prepare``.
        """
        self.planned(system, ())
        if system.n > UNASKED_MASSES:
            raise NotApplicable(f"{system.n} masses may take minutes; ask for it by its name")
        if system.damping_terms and system.n > 1:
            raise NotApplicable("damping terms may take minutes; ask for it by its name")
        for closed in (Exact(), Linear()):
            if closed.refusal(system, (Coordinate("q", 0),)) is None:
                raise NotApplicable(f"{closed.method} has the same density to more digits")
        return replace(
            self,
            tol=max(self.tol, PhaseSpace.tol),
            accepted=max(self.tol, 0.1 * LARGEST),
            work=min(self._options().work, share * UNASKED_WORK),
            threads=self.threads or 1,
        )

    def prepare(self, system: System) -> Plan:
        """Return the plan; raise ``NotApplicable`` as ``_frame`` and ``require_broad`` do."""
        ladders: Callable[..., Iterator[Ladder]]
        of: Callable[..., Ladder]
        frame, tol = self._frame(system), self.accepted or self.tol
        if system.n == 1:
            oscillator = oscillator_of(system)
            require_broad(oscillator)
            ladders, of = partial(plane_ladder, oscillator), plane_ladder_of
        else:
            ladders, of = partial(solution_ladder, frame, tol=tol), ladder_of

        def refusal(observable: Observable) -> str | None:
            if any(c.kind == "H" for c in observable):
                words = "gives densities of q and p, not of energies; ask for these or pairs"
                return f"{observable_name(observable)}: {self.method} {words}"
            return None

        def attempt(observables: Sequence[Observable], progress: Progress) -> str | None:
            if system.n == 1:
                return None  # no error is out of reach
            try:
                with breakdowns():
                    for ladder in islice(ladders(observables, self._options(progress)), 2):
                        if max(ladder.errors.values()) <= max(tol, HOPELESS):
                            break
            except (NotApplicable, NotCertified) as reason:
                return str(reason)
            return None

        @breakdowns()
        def solve(
            observables: Sequence[Observable], progress: Progress, beside: Sequence[Observable] = ()
        ) -> Result:
            # For each observable the solution with the smallest error.
            best: dict[Observable, Ladder] = {}
            for ladder in ladders(observables, self._options(progress)):
                best = {o: better(best.get(o, ladder), ladder, o) for o in observables}
                worst = max(own.errors[o] for o, own in best.items())
                if worst <= self.tol:
                    break
            if self.accepted and worst > self.accepted:
                raise NotCertified(f"an L1 error of {worst:.1g} was reached: {ladder.limit}")
            others = of(ladder.finest, ladder.coarser, beside) if beside else ladder
            return Result(
                self,
                tuple(
                    expansion_density(replace(best[o], limit=ladder.limit), o, tol)
                    for o in observables
                ),
                identities=identities(ladder),
                settings=expansion_settings(ladder),
                beside=tuple(expansion_density(others, o, inf) for o in beside),
            )

        return Plan(refusal, solve, beside=True, attempt=attempt)

    @answer
    def crossings(self, asked: Asked) -> Curve:
        """Return the upcrossings per unit time of levels by q, from the joint density of (q, p)."""
        frame = self._frame(asked.system)
        levels = partial(dynamics.about_levels, frame=frame, row=asked.row, at=asked.at)
        single = np.float32  # of the stationary solution, without a further elimination
        return self._curve(asked, "crossings", CROSSINGS_TOL, apart=levels, numbers=single)

    @answer
    def spectrum(self, asked: Asked) -> Curve:
        """Return the two-sided power spectral density of q, by the resolvent of the operator."""
        return self._curve(asked, "spectrum", SPECTRUM_TOL)

    @answer
    def correlation(self, asked: Asked) -> Curve:
        """Return the autocovariance of q at lags, from the exponential of the FPK operator."""
        return self._curve(asked, "correlation", CORRELATION_TOL, numbers=float)

    @answer
    def relaxation(self, asked: Asked) -> Rates:
        """Return the ``asked.count`` slowest eigenvalues λ of −L, L the FPK operator; Im λ >= 0."""
        require_held(asked.system)
        frame, wanted = self._frame(asked.system), asked.tol or RELAXATION_TOL
        options, momentum = self._options(asked.progress), (Coordinate("p", frame.contact),)
        measure = partial(dynamics.relaxation, count=asked.count, work=options.work)
        ladders = self._ladders(frame, [momentum], options)
        ladder, answer = dynamics.adapt(
            ladders, measure, options, dynamics.nearest, tol=wanted, what="relaxation"
        )
        values = np.asarray(answer.values, dtype=complex)
        stationary = expansion_density(ladder, momentum, wanted).certificate
        measured = Measured(
            l1_error=answer.relative,
            mass_defect=stationary.mass_defect,
            minimum=float(np.min(values.real / np.abs(values))),
            residual=stationary.residual,
            tail_mass=stationary.tail_mass,
            failures=tuple(words for words in (answer.missing, answer.limit) if words),
        )
        certificate = certify(measured, tol=wanted)
        return Rates(values, np.asarray(answer.errors), certificate, expansion_settings(ladder))

    def _curve(
        self,
        asked: Asked,
        name: str,
        default: float,
        *,
        apart: dynamics.Apart = dynamics.largest,
        numbers: type = complex,
    ) -> Curve:
        """Return the curve of the function ``name`` of ``dynamics``, with its certificate.

        The relative tolerance is ``asked.tol``, or ``default`` if that is None; ``apart`` measures
        the difference of two answers, ``numbers`` is the type of the numbers of the elimination.
        """
        tol, row, frame = asked.tol or default, asked.row, self._frame(asked.system)
        measure = partial(getattr(dynamics, name), frame=frame, row=row, at=asked.at, tol=tol)
        # With a momentum, since the tolerance then holds for the whole stationary state.
        q, p = (Coordinate("q", row),), (Coordinate("p", row),)
        options = self._options(asked.progress)
        ladders = self._ladders(frame, [q, p], options)
        ladder, answer = dynamics.adapt(
            ladders, measure, options, apart, tol=tol, what=name, numbers=numbers
        )
        values, scale = np.asarray(answer.values, dtype=float), float(answer.scale)
        return certify_curve(
            values,
            np.asarray(answer.errors),
            scale=scale,
            of=expansion_density(ladder, q, inf),
            tol=tol,
            residual=answer.residual,
            failures=(answer.limit,) if answer.limit else (),
            settings=expansion_settings(ladder),
            # An autocovariance is within ± its scale.
            positive=scale - np.abs(values) if name == "correlation" else None,
        )

    @answer
    def transient(self, asked: Asked) -> Transient:
        """Return the densities of q and p of one mass in time, by finite elements in the plane."""
        asked = replace(asked, tol=asked.tol or self.tol)
        return plane_transient(asked, self._options(asked.progress))

    @answer
    def passage(self, asked: Asked) -> Passage:
        """Return the first passage of one mass, by finite elements of the backward equation."""
        return phase_space_passage(asked)

    def _options(self, progress: Progress = silent) -> Options:
        work = self.work
        if work is None:  # for dense blocks of order N work is N³ and memory N²
            work = SOLUTION_WORK * (self.memory / SOLUTION_MEMORY) ** 1.5
        return Options(self.memory, work, self.threads, progress)

    @staticmethod
    def _ladders(frame: Frame, of: Sequence[Observable], options: Options) -> Iterator[Ladder]:
        """Return ladders with the errors of the observables ``of``, for questions in time."""
        if frame.n > 1:
            return solution_ladder(frame, of, options)
        return uniform_ladder(oscillator_of(frame.system), of, options)

    def _frame(self, system: System) -> Frame:
        """Return the frame of ``system``.

        Raises ``NotApplicable`` for more than ``MOST_EXPANSION_MASSES`` masses, stops on several of
        them, no damping or no noise, and damping terms whose equations exceed memory or work.
        """
        if system.n > MOST_EXPANSION_MASSES:
            most = f"the expansion is for {2 * MOST_EXPANSION_MASSES} at the most"
            raise NotApplicable(f"{system.n} masses have {2 * system.n} coordinates; {most}")
        frame = contact_frame(system)
        about = gibbs_reference(frame)
        if system.damping_terms and system.n > 1:
            first = first_degrees(frame)
            second = next_degrees(frame, first, first.others)
            if words := self._options().refusal(*solution_cost(basis(frame, about, second))):
                raise NotApplicable(f"the damping terms are of too high a degree: {words}")
        return frame


PhaseSpace.register(quick=False)
