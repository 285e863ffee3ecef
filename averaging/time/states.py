"""Densities of displacements and momenta in time from that of the energy, Eqs. (23), (30).

Given the energy the state is distributed over its shell as in the stationary state, so that
ρ(q, p, t) = u(H, t), u = p(H, t)/T(H). Soon after the start u is as narrow as the noise has made it
by then: all integrals have panels that end where the elements of p(H, t) end.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import gamma

import numpy as np

from averaging.back_transformation import observed_energy, reduced
from averaging.conditional import Conditional
from averaging.time.start import DensityQuestion
from averaging.weyl import weyl_integral
from fpk.arrays import CHUNK, EPS, SMALLEST, Array
from fpk.certificate import certify
from fpk.errors import NotApplicable
from fpk.evolution import Transient
from fpk.line.mesh import with_layers
from fpk.line.time.transition import ROUND_OFF, SAFETY, Transition, common_error
from fpk.observable import observable_name
from fpk.piecewise import Piecewise, interpolated
from fpk.quadrature import gauss_legendre, panel_rule
from fpk.system import System

RULES = (10, 14)
"""Gauss points a panel over a hidden contact mass; the distance of the two is the error."""
ERROR_POINTS = 4
"""Gauss points a panel of the integral of the error of Ψ, an estimate."""
BISECTIONS = 50
"""Halvings by which ends of panels are found: 1e-15 of the range."""
LAYERS = np.append(4.0 ** -np.arange(9.0), 0.0)
"""Ends of panels beyond a stop, as shares of the way to the end: (H − V) ~ overlap^2.5 there."""
POINTS = (20, 24)
"""Gauss points an element of the coarser table of Ψ, and of the answer."""
CHECKED = 21
"""Points an element at which errors of u are measured, none of which is one of its table."""


@dataclass(frozen=True, eq=False)
class WeylInTime:
    """Ψ(E) = ∫_E u(H) (H − E)^(ν−1)/Γ(ν) dH at all times, ν = ``order`` = 0, ½, 1, …; Ψ_0 is u."""

    solved: Transition
    order: float

    @cached_property
    def nodes(self) -> Array:
        """Ends of halves of the enriched solution's elements, with layers at contact energies."""
        nodes = self.solved.enriched.elements.nodes
        halves = np.sort(np.append(nodes, 0.5 * (nodes[1:] + nodes[:-1])))
        return with_layers(halves, self.solved.enriched.process.nonsmooth)

    def __call__(self, energy: Array) -> Array:
        """Return Ψ at ``energy``, (*shape, times)."""
        return self._table(energy)

    def error(self, energy: Array) -> Array:
        """Return the error of Ψ; beyond the last element Ψ is less than its error before."""
        last = 0.5 * float(self.nodes[-2] + self.nodes[-1])
        E = np.minimum(energy, last).ravel()
        k = np.searchsorted(self.nodes, E, side="right") - 1
        total = self._moved[k]
        if self.order == 0.0:
            total = total + self._of_u[k]
        else:
            with np.errstate(invalid="ignore"):
                powers = np.maximum(self.nodes - E[:, None], 0.0) ** self.order
            total = total + np.diff(powers, axis=1) @ self._of_u / gamma(self.order + 1.0)
        return np.asarray(total.reshape(*np.shape(energy), -1))

    @property
    def added(self) -> float:
        """The error of the table relative to the largest Ψ."""
        return float(np.max(self._moved / np.max(np.abs(self._table.coefficients[:, 0]), axis=0)))

    @cached_property
    def _u(self) -> Piecewise:
        """u at all times."""
        return self._of_energy(lambda x: self._answer(x)[0], POINTS[1])

    def _answer(self, x: Array) -> tuple[Array, Array]:
        """u and the size of its terms (points, times); 0 beyond the last element of the answer."""
        u, size = self.solved.solution.state_density(x)
        inside = x <= self.solved.elements.right[-1]
        return (u * inside).T, (size * inside).T

    @cached_property
    def _of_u(self) -> Array:
        """The largest error of u in each element (elements, times)."""
        x = panel_rule(self.nodes, CHECKED)[0]
        u, size = self._answer(x.ravel())
        better, other = self.solved.enriched.state_density(x.ravel())
        error = SAFETY * (np.abs(u - better.T) + np.abs(u - self._u(x.ravel())))
        within = np.minimum(x.ravel(), self.solved.elements.right[-1])
        question = self.solved.question
        error += common_error(question, self.solved.elements, u.T, size.T + other, within).T
        # What is left of larger numbers far from the peak, of u and of p = T u.
        c = question.process.coefficients(x.ravel())
        with np.errstate(over="ignore"):
            of_p = np.multiply.outer(np.exp(-c.log_density_of_states), self.solved.top)
        error += ROUND_OFF * EPS * np.minimum(of_p, np.abs(u).max(axis=0))
        return np.asarray(error.reshape(*x.shape, -1).max(axis=1))

    @cached_property
    def _table(self) -> Piecewise:
        if self.order == 0.0:
            return self._u
        return self._of_energy(lambda E: self._integral(E, POINTS[1]), POINTS[1])

    @cached_property
    def _moved(self) -> Array:
        """Largest distance of two tables in each element (elements, times)."""
        f = self._u if self.order == 0.0 else lambda E: self._integral(E, POINTS[0])
        coarse = self._of_energy(f, POINTS[0])
        x = panel_rule(self.nodes, sum(POINTS))[0]
        distance = np.abs(coarse(x) - self._table(x)).max(axis=1)
        return np.asarray(distance + ROUND_OFF * EPS * np.abs(self._table(x)).max(axis=1))

    def _of_energy(self, f: Callable[[Array], Array], points: int) -> Piecewise:
        left, right = self.nodes[:-1], self.nodes[1:]
        return Piecewise(self.nodes, interpolated(f, left, right, points - 1))

    def _integral(self, energy: Array, points: int) -> Array:
        return weyl_integral(self.order, self.nodes, self._u, energy, points=points)


def state_transient(system: System, solved: Transition, asked: DensityQuestion) -> Transient:
    """Return the densities of one or two of (q, p).

    Momenta and masses without contact are integrated out exactly, one contact mass that is not
    observed by quadrature. The L1 error is that of the energy, as integrating out increases none,
    and what tables and quadrature add. Raises ``NotApplicable`` for more hidden contact masses.
    """
    observable, at = asked.observable, asked.at
    seen = [c.row for c in observable if c.kind == "q"]
    hidden = [i for i in system.contact_masses if i not in seen]
    if len(hidden) > 1:
        raise NotApplicable(
            f"{observable_name(observable)}: in time one contact mass at the most is integrated "
            f"out, here {len(hidden)} are not observed"
        )
    unit = solved.question.process.energy_scale
    order, log_factor, laws = reduced(system, observable, hidden, unit)
    psi = WeylInTime(solved, order)
    Q, energy = observed_energy(system, observable, laws, list(at))
    if hidden:
        values, errors, rule_error = _over_hidden(psi, laws[-1], energy, Q)
    else:
        values, errors, rule_error = psi(energy), psi.error(energy), np.zeros(1)
    factor = float(np.exp(log_factor))
    highest = max(float(np.max(np.abs(values), initial=0.0)), SMALLEST)
    # The largest error of the rule over hidden masses, everywhere that the last energy allows.
    own = [
        (np.diag(system.compliance) if c.kind == "q" else system.mass)[c.row] for c in observable
    ]
    volume = float(np.prod(2.0 * np.sqrt(2.0 * psi.nodes[-1] * np.array(own))))
    measured = replace(
        solved.measured,
        l1_error=solved.measured.l1_error + psi.added + factor * volume * float(rule_error.max()),
        minimum=float(values.min(initial=0.0)) / highest,
        absolute_error=float(errors.max(initial=0.0)) / highest,
    )
    return Transient(
        asked.times,
        factor * values.T,
        factor * errors.T + SMALLEST,
        "numerical",
        certify(measured, tol=asked.tol),
        solved.settings,
    )


def _over_hidden(
    psi: WeylInTime, law: Conditional, energy: Array, given: Array
) -> tuple[Array, Array, Array]:
    """∫Ψ(E + V(hidden | observed)), its error, and that of the rule: (points, times) each."""
    parts = []
    mean = law.weights @ given if given.size else np.zeros(energy.size)
    size = max(1, CHUNK // (2 * psi.nodes.size**2 * ERROR_POINTS))
    for start in range(0, energy.size, size):
        part = slice(start, start + size)
        nodes = _panels(psi.nodes, law, energy[part], mean[part])
        parts.append(_integrals(psi, law, nodes, energy[part], mean[part]))
    values, errors, rule = (np.concatenate(column) for column in zip(*parts, strict=True))
    return values, errors + rule, rule


def _integrals(
    psi: WeylInTime, law: Conditional, nodes: Array, energy: Array, mean: Array
) -> tuple[Array, Array, Array]:
    answers = []
    for points in (*RULES, ERROR_POINTS):
        t, w = gauss_legendre(points)
        half = 0.5 * np.diff(nodes, axis=1)[..., None]
        q = nodes[:, :-1, None] + half * (1.0 + t)
        E = energy[:, None, None] + law.energy(q, mean[:, None, None])
        f = psi.error if points == ERROR_POINTS else psi
        answers.append(np.einsum("xkg,xkgt->xt", half * w, f(E)))
    coarse, fine, error = answers
    # Beyond the panels V is above the last energy, where Ψ is less than this error and falls.
    reach = np.sqrt(2.0 * psi.nodes[-1] / law.precision)
    return fine, error + reach * psi.error(psi.nodes[-1:]), np.abs(fine - coarse)


def _panels(energies: Array, law: Conditional, energy: Array, mean: Array) -> Array:
    """Nodes (points, nodes) of the hidden mass, where E + V is one of ``energies`` or a stop is.

    V is convex. Panels that would be beyond the last energy have no length.
    """

    def V(q: Array) -> Array:
        return law.energy(q, np.reshape(mean, (-1,) + (1,) * (q.ndim - 1)))

    reach = np.sqrt(2.0 * np.maximum(energies[-1] - energy, 0.0) / law.precision)
    low, high = mean - reach, mean + reach
    for _ in range(2 * BISECTIONS):
        third = (high - low) / 3.0
        falls = V(low + third) > V(high - third)
        low, high = np.where(falls, low + third, low), np.where(falls, high, high - third)
    rest = 0.5 * (low + high)
    ends = {}
    for sign in (-1.0, 1.0):
        inside = np.repeat(rest[:, None], energies.size, axis=1)
        outside = np.repeat((mean + sign * reach)[:, None], energies.size, axis=1)
        for _ in range(BISECTIONS):
            middle = 0.5 * (inside + outside)
            below = energy[:, None] + V(middle) < energies
            inside, outside = np.where(below, middle, inside), np.where(below, outside, middle)
        ends[sign] = outside
    low, high = (side[:, -1:] for side in ends.values())
    layers = [np.empty((energy.size, 0))]
    for stop in law.stops:
        at = stop.sign * stop.clearance
        layers.append(np.clip(at + (ends[stop.sign][:, -1:] - at) * LAYERS, low, high))
    return np.sort(np.hstack([*ends.values(), *layers]), axis=1)
