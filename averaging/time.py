"""Transients by the averaged equations: starts and limits of energies, densities of q and p.

Densities of displacements and momenta follow from the density p(H, t) of the total energy, Eqs.
(23), (30): given H the state is distributed over its energy shell as in the stationary state, so
that ρ(q, p, t) = u(H, t), u = p(H, t)/T(H). Soon after the start u is a narrow peak; so the panels
of all integrals end at the ends of the elements of p(H, t).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from averaging.back_transformation import reduction
from averaging.conditional import HIDDEN_RULES, hidden_integral
from averaging.modal.analysis import ModalAnalysis
from averaging.weyl import weyl_integral
from averaging.zero_flux import ENERGY_RULES
from fpk.answer.certificate import DISTANCE_FACTOR, certify
from fpk.answer.dynamics import Transient
from fpk.answer.names import Limit, Observable, number_text, observable_name
from fpk.answer.question import Asked
from fpk.numeric.arrays import DEPTH, EPS, ROUNDINGS, SMALLEST, Array
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.numeric.piecewise import Piecewise, legendre_coefficients
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.mesh import with_layers
from fpk.solvers.line.time.transition import Transition

MODAL_TOL = 1e-8
"""Tolerance ``Asked.tol`` of answers in time by modal energies if none is given."""
ERROR_POINTS = 4
"""Gauss points per panel of the integral of the error of Ψ over a hidden displacement: few, as the
error is an estimate."""


@dataclass(frozen=True, eq=False)
class EnergyStart:
    """The energies at time 0: known values, or random with a stationary density.

    ``energies`` are the modal energies (n,) or the total energy (1,). If ``noise`` is given, they
    are zeros, and the start has the stationary density under ``noise`` times the noise matrix D.
    """

    energies: Array
    noise: float | None = None

    def known(self) -> Array:
        """Return the energies; raise ``NotApplicable`` if the start is a stationary state."""
        if self.noise is not None:
            raise NotApplicable("from a stationary state first passage has no closed form; use fem")
        return self.energies


def with_energy_start(asked: Asked, tol: float, modes: ModalAnalysis | None = None) -> Asked:
    """Return a copy of ``asked`` with the tolerance ``tol`` and an ``EnergyStart`` as start.

    The start holds modal energies if ``modes`` are given, otherwise the total energy; a stationary
    start under no noise (0) is a start at rest. Raises
    ``NotApplicable`` for modal energies without ``modes``, and for a total energy of several modes.
    """
    start, system, n = asked.start, asked.system, 1 if modes is None else modes.n
    values, noise = start.values, None
    if start.rest or start.kind == "noise":
        energies, noise = np.zeros(n), values.get("noise") or None
    elif start.kind == "modal":
        if modes is None:
            words = "this theory knows the total energy only; start from H=.. or a state"
            raise NotApplicable(words)
        energies = np.array([values[f"H{i + 1}"] for i in range(n)])
    elif start.kind == "energy":
        if n > 1:
            words = "give every modal energy, H1=..,H2=..: their sum is not enough"
            raise NotApplicable(f"{start}: {words}")
        energies = np.array([values["H"]])
    else:
        q, p = start.state(system.n)
        energies = np.array([float(system.hamiltonian(q, p))])
        if modes is not None:
            Q, P = modes.mode_shapes.T @ (system.mass * q), modes.mode_shapes.T @ p
            energies = 0.5 * (P**2 + (modes.natural_frequency * Q) ** 2)
    return replace(asked, start=EnergyStart(energies, noise), tol=tol)


def modes_of_observable(observable: Observable) -> list[int]:
    """Return the modes (0-based) of the energies in ``observable``, empty for their sum H.

    Raises ``NotApplicable`` if it contains q or p, or H beside other quantities.
    """
    rows = [c.row for c in observable if c.index is not None]
    if any(c.kind != "H" for c in observable) or len(observable) != max(len(rows), 1):
        name = observable_name(observable)
        raise NotApplicable(
            f"{name}: in time modal energies H1, H2, …, two of them, or their sum H; "
            "or one or two of q and p"
        )
    return rows


def modal_limits(limit: Limit, start: EnergyStart) -> dict[int, float]:
    """Return the limit of each limited modal energy by its 0-based mode, empty for the sum H.

    Raises ``NotApplicable`` for a displacement or velocity, ``InvalidInput`` for a start at or
    above the limit.
    """
    if not limit.of_energy:
        words = "averaged modal energies know no displacement or velocity; use H, H1, …"
        raise NotApplicable(f"{limit}: {words}")
    energies = {f"H{m + 1}": float(H) for m, H in enumerate(start.energies)}
    energies["H"] = sum(energies.values())
    if any(energies[name] >= value for name, value in limit.values.items()):
        given = ",".join(map(number_text, start.energies.tolist()))
        raise InvalidInput("start", given, f"must be below the limit {limit}")
    return {int(name[1:]) - 1: a for name, a in limit.values.items() if name != "H"}


@dataclass(frozen=True, eq=False)
class WeylInTime:
    """Ψ(E, t) = ∫_E u(H, t) (H − E)^(ν−1)/Γ(ν) dH at the times of ``solved``; Ψ of order 0 is u.

    ν is ``order`` = 0, ½, 1, ….
    """

    solved: Transition
    order: float

    @cached_property
    def nodes(self) -> Array:
        """Element ends of the tables: enriched elements halved, layers at contact energies."""
        e = self.solved.enriched.elements
        halves = np.sort(np.append(e.nodes, 0.5 * (e.nodes[1:] + e.nodes[:-1])))
        return with_layers(halves, e.process.nonsmooth)

    def __call__(self, energy: Array) -> Array:
        """Return Ψ at ``energy`` of any shape, (*shape, times); 0 beyond the last node."""
        return self.tables[-1](energy)

    def error(self, energy: Array) -> Array:
        """Return the absolute error of Ψ at ``energy`` of any shape, (*shape, times).

        Beyond the last element, where Ψ is given as 0, it is the error in the last element.
        """
        last = 0.5 * float(self.nodes[-2] + self.nodes[-1])
        E = np.minimum(energy, last).ravel()
        k = np.searchsorted(self.nodes, E, side="right") - 1
        if self.order == 0.0:
            of_u = self._error_of_u[k]
        else:
            with np.errstate(invalid="ignore"):
                powers = np.maximum(self.nodes - E[:, None], 0.0) ** self.order
            of_u = np.diff(powers, axis=1) @ self._error_of_u / math.gamma(self.order + 1.0)
        return np.asarray((self.table_error[k] + of_u).reshape(*np.shape(energy), -1))

    def _answer(self, x: Array) -> tuple[Array, Array]:
        """Return u at ``x`` (points,) and the sum of its terms' absolute values, (points, times).

        Both are 0 beyond the last element of the solution.
        """
        u, size = self.solved.solution.density(x, of_states=True)
        inside = x <= self.solved.elements.right[-1]
        return (u * inside).T, (size * inside).T

    @cached_property
    def tables(self) -> tuple[Piecewise, Piecewise, Piecewise]:
        """Tables of u, of Ψ by fewer points for comparison, and of Ψ, the answer."""

        def table(f: Callable[[Array], Array], points: int) -> Piecewise:
            ends = self.nodes[:-1], self.nodes[1:]
            return Piecewise(self.nodes, legendre_coefficients(f, *ends, points - 1))

        u = table(lambda x: self._answer(x)[0], ENERGY_RULES[1])
        if self.order == 0.0:
            return u, table(u, ENERGY_RULES[0]), u
        integral = partial(weyl_integral, self.order, self.nodes, u)
        coarse, fine = (table(partial(integral, points=k), k) for k in ENERGY_RULES)
        return u, coarse, fine

    @cached_property
    def _error_of_u(self) -> Array:
        """The largest absolute error of u in each element, (elements, times)."""
        solved, e = self.solved, self.solved.elements
        # Points that are not interpolation points of the table of u.
        points = panel_rule(self.nodes, ENERGY_RULES[0] + 1)[0]
        x = points.ravel()
        u, size = self._answer(x)
        better, other = solved.enriched.density(x, of_states=True)
        error = DISTANCE_FACTOR * (np.abs(u - better.T) + np.abs(u - self.tables[0](x)))
        within = np.minimum(x, e.right[-1])
        error += solved.question.common_error(e, u.T, size.T + other, within).T
        # Far from the peak u and p = T u are differences of larger numbers, hence the round-off.
        c = e.process.coefficients(x)
        with np.errstate(over="ignore"):
            of_p = np.multiply.outer(np.exp(-c.log_density_of_states), solved.top)
        error += ROUNDINGS * EPS * np.minimum(of_p, np.abs(u).max(axis=0))
        return np.asarray(error.reshape(*points.shape, -1).max(axis=1))

    @cached_property
    def table_error(self) -> Array:
        """The largest difference of both tables of Ψ plus round-off, (elements, times)."""
        x = panel_rule(self.nodes, sum(ENERGY_RULES))[0]
        _, coarse, fine = (table(x) for table in self.tables)
        distance = np.abs(coarse - fine).max(axis=1)
        return np.asarray(distance + ROUNDINGS * EPS * np.abs(fine).max(axis=1))


def state_transient(solved: Transition, asked: Asked) -> Transient:
    """Return the densities ``asked`` for, of one or two of (q, p), from p(H, t) = ``solved``.

    The L1 error is the sum of the L1 error of p(H, t), which integrating out does not increase, and
    the errors of tables and quadrature. At most one contact mass that is not observed is integrated
    out, by quadrature; raises ``NotApplicable`` for more.
    """
    system, observable, at = asked.system, asked.observable, asked.at
    seen = [c.row for c in observable if c.kind == "q"]
    hidden = [i for i in system.contact_masses if i not in seen]
    if len(hidden) > 1:
        raise NotApplicable(
            f"{observable_name(observable)}: in time one contact mass at the most is integrated "
            f"out, here {len(hidden)} are not observed"
        )
    # The energy at which the process takes T relative to that without contact.
    unit = solved.elements.process.energy_scale
    order, log_factor, laws, observed = reduction(system, observable, hidden, unit)
    psi = WeylInTime(solved, order)
    Q, energy = observed(at)
    end = float(psi.nodes[-1])
    over_hidden = partial(
        hidden_integral,
        energy=energy,
        given=Q,
        laws=laws,
        temperature=end / DEPTH,
        end=end,
        cuts=psi.nodes,
    )
    coarse, values = (over_hidden(psi, points=points) for points in HIDDEN_RULES[1])
    rule_error = np.abs(values - coarse)
    errors = over_hidden(psi.error, points=ERROR_POINTS) + rule_error
    if hidden:  # a bound of the integral beyond the panels, where E + V is above the last energy
        errors = errors + np.sqrt(2.0 * end / laws[0].precision) * psi.error(np.array([end]))
    factor = float(np.exp(log_factor))
    highest = max(float(np.max(np.abs(values), initial=0.0)), SMALLEST)
    # Volume of the observed coordinates up to the last energy; times the largest error of the rule
    # over the hidden mass it bounds that error's integral.
    own = [
        (np.diag(system.compliance) if c.kind == "q" else system.mass)[c.row] for c in observable
    ]
    volume = float(np.prod(2.0 * np.sqrt(2.0 * psi.nodes[-1] * np.array(own))))
    # Error of the table, relative to the largest Ψ.
    added = float(np.max(psi.table_error / np.abs(psi.tables[-1].coefficients[:, 0]).max(axis=0)))
    measured = replace(
        solved.measured,
        l1_error=solved.measured.l1_error + added + factor * volume * float(rule_error.max()),
        minimum=float(values.min(initial=0.0)) / highest,
        absolute_error=float(errors.max(initial=0.0)) / highest,
    )
    numbers = factor * values.T, factor * errors.T + SMALLEST
    certificate = certify(measured, tol=asked.tol)
    return Transient(asked.times, *numbers, "numerical", certificate, solved.settings)
