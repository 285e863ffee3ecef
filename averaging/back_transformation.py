"""From a density of the energy to densities of displacements and momenta, Eqs. (23), (30)."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from averaging.energy_density import EnergyDensity
from averaging.shell.reduced import compliance_matrix
from fpk.contact import Contact
from fpk.density import Density
from fpk.errors import NotApplicable
from fpk.observable import Observable, observable_name
from fpk.quadrature import panel_rule

Array = NDArray[np.float64]

POINTS = {0: (1, 1), 1: (16, 20), 2: (8, 10)}
"""Gauss points per panel over 0, 1 or 2 contact masses that are not observed, and of the finer
rule whose distance is the error estimate."""
CHUNK = 400_000
"""Points of an inner integral evaluated at once, to bound memory."""


def back_transformed(source: EnergyDensity, observable: Observable) -> Density:
    """Return the density of ``observable`` that belongs to the phase-space density u(H).

    Momenta and masses without contact are quadratic in H and integrated out exactly (Weyl
    integrals of u); contact masses that are not observed are integrated out by quadrature. For
    one contact mass, p(q_c) needs none: p(q_c) ~ Ψ(V_red(q_c)).

    Raises ``NotApplicable`` for modal energies, for H beside another coordinate, and where more
    than two contact masses would have to be integrated out.
    """
    kinds = [coordinate.kind for coordinate in observable]
    name = observable_name(observable)
    if "H" in kinds:
        if len(observable) > 1 or observable[0].index is not None:
            raise NotApplicable(
                f"{name} does not follow from a density that depends on the total energy only"
            )
        return _energy_density(source, observable)
    system = source.system
    q = tuple(c.index for c in observable if c.kind == "q" and c.index is not None)
    p = tuple(c.index for c in observable if c.kind == "p" and c.index is not None)
    hidden = tuple(i for i in system.contact_masses if i not in q)
    if len(hidden) > 2:
        raise NotApplicable(f"{name}: {len(hidden)} contact masses would have to be integrated out")
    axes = [coordinate.kind for coordinate in observable]
    coarse, fine = (_Marginal(source, q, p, hidden, points) for points in POINTS[len(hidden)])

    def pdf(*x: Array) -> Array:
        return fine(source.weyl, _split(axes, x))

    def pointwise(*x: Array) -> Array:
        split = _split(axes, x)
        quadrature = np.abs(fine(source.weyl, split) - coarse(source.weyl, split))
        return fine(source.weyl_error, split) + quadrature

    end = float(source.nodes[-1])
    panels = tuple(
        displacement_panels(source, c.index)
        if c.kind == "q"
        else _momentum_panels(system.mass[c.index], end, source.temperature)
        for c in observable
        if c.index is not None
    )
    return Density(
        observable, panels, pdf, pointwise, source.l1_error, source.certificate, source.provenance
    )


def _energy_density(source: EnergyDensity, observable: Observable) -> Density:
    # p falls beyond the last node, where some solvers drop it: its value there bounds the loss.
    last = source.nodes[-1]
    dropped = source.energy_pdf(np.array([last * (1.0 - 1e-9)]))[0]

    def pointwise(energy: Array) -> Array:
        energy = np.asarray(energy)
        error = np.exp(source.log_states(energy)) * source.u_error(energy)
        error = np.where((energy > last) & (source.u(energy) == 0.0), dropped, error)
        return np.where(energy >= 0.0, error, 0.0)

    return Density(
        observable,
        (source.nodes,),
        source.energy_pdf,
        pointwise,
        source.l1_error,
        source.certificate,
        source.provenance,
    )


def _split(axes: Sequence[str], x: tuple[Array, ...]) -> tuple[list[Array], list[Array]]:
    """Displacements and momenta among the coordinates, in their order, broadcast together."""
    arrays = np.broadcast_arrays(*(np.asarray(part, dtype=float) for part in x))
    by_kind: dict[str, list[Array]] = {"q": [], "p": []}
    for kind, part in zip(axes, arrays, strict=True):
        by_kind[kind].append(part)
    return by_kind["q"], by_kind["p"]


class _Marginal:
    """Integral of u(H) over everything but some displacements and momenta."""

    def __init__(
        self,
        source: EnergyDensity,
        q: tuple[int, ...],
        p: tuple[int, ...],
        hidden: tuple[int, ...],
        points: int,
    ) -> None:
        """Prepare the quadratic part, which is exact, and the grid of the hidden contact masses."""
        system = source.system
        self.system, self.q, self.p, self.hidden = system, q, p, hidden
        kept = [*q, *hidden]
        compliance = compliance_matrix(system)[np.ix_(kept, kept)]
        self.K = np.linalg.inv(compliance) if kept else np.zeros((0, 0))
        self.order = 0.5 * (system.n - len(p)) + 0.5 * (system.n - len(kept))
        _, log_det = np.linalg.slogdet(compliance) if kept else (1.0, 0.0)
        # ln det K_ff of the masses integrated out exactly: det K · det(compliance of the others).
        log_det_free = float(np.sum(np.log(system.stiffness)) + log_det)
        others = np.delete(system.mass, list(p))
        self.factor = float(
            np.exp(
                self.order * np.log(2.0 * np.pi) + 0.5 * np.sum(np.log(others)) - 0.5 * log_det_free
            )
        )
        grids = [panel_rule(displacement_panels(source, i), points) for i in hidden]
        mesh = np.meshgrid(*(x.ravel() for x, _ in grids), indexing="ij")
        weights = np.meshgrid(*(w.ravel() for _, w in grids), indexing="ij")
        size = mesh[0].size if hidden else 1
        self.y = np.array([part.ravel() for part in mesh]).reshape(len(hidden), size)
        self.w = np.prod([part.ravel() for part in weights], axis=0) if hidden else np.ones(1)
        self.hidden_energy = 0.5 * np.einsum(
            "ix,ij,jx->x", self.y, self.K[len(q) :, len(q) :], self.y
        )
        for row, i in zip(self.y, hidden, strict=True):
            self.hidden_energy = self.hidden_energy + system.contact_energy(i, row)

    def __call__(
        self, weyl: Callable[[float, Array], Array], x: tuple[list[Array], list[Array]]
    ) -> Array:
        """The density at displacements and momenta of one common shape."""
        q, p = x
        shape = (q or p)[0].shape
        size = (q or p)[0].size
        Q = np.array([part.ravel() for part in q]).reshape(len(q), size)
        energy = 0.5 * np.einsum("ix,ij,jx->x", Q, self.K[: len(q), : len(q)], Q)
        for row, i in zip(Q, self.q, strict=True):
            energy = energy + self.system.contact_energy(i, row)
        for momentum, i in zip(p, self.p, strict=True):
            energy = energy + momentum.ravel() ** 2 / (2.0 * self.system.mass[i])
        coupling = Q.T @ self.K[: len(q), len(q) :]
        rows = max(1, CHUNK // self.w.size)
        result = np.empty(size)
        for start in range(0, size, rows):
            part = slice(start, start + rows)
            inner = energy[part, None] + coupling[part] @ self.y + self.hidden_energy
            result[part] = weyl(self.order, inner) @ self.w
        return (self.factor * result).reshape(shape)


def displacement_panels(source: EnergyDensity, mass: int) -> Array:
    """Return panel nodes of q_mass: the range that the last energy allows, cut at its stops.

    Panels have the width of the thermal displacement of the free mass, and grow geometrically
    from a thousandth of the thermal overlap above every stop of this mass.
    """
    end = float(source.nodes[-1])
    compliance = float(compliance_matrix(source.system)[mass, mass])
    thermal = np.sqrt(compliance * source.temperature)
    stops = [stop for stop in source.system.stops if stop.index == mass]
    limits = {side: _limit(stops, side, compliance, end) for side in ("left", "right")}
    low, high = -limits["left"], limits["right"]
    nodes = [np.linspace(low, high, max(4, int(np.ceil((high - low) / thermal))) + 1)]
    for stop in stops:
        sign = 1.0 if stop.side == "right" else -1.0
        room = limits[stop.side] - stop.clearance
        if room > 0:
            first = 1e-3 * min(_overlap_at(stop, source.temperature, room), room)
            layers = np.geomspace(first, room, max(2, int(np.ceil(np.log2(room / first)))))
            nodes.append(sign * (stop.clearance + np.concatenate([[0.0], layers])))
    return _spaced(np.concatenate(nodes))


def _momentum_panels(mass: float, end: float, temperature: float) -> Array:
    """Panels of at the most two thermal momenta, 16 or more."""
    reach = float(np.sqrt(2.0 * mass * end))
    panels = max(16, int(np.ceil(np.sqrt(2.0 * end / temperature))))
    return np.linspace(-reach, reach, panels + 1)


def _limit(stops: list[Contact], side: str, compliance: float, end: float) -> float:
    """Distance that a mass can go to one side with the energy ``end``."""
    limit = float(np.sqrt(2.0 * compliance * end))
    for stop in stops:
        if stop.side == side and stop.clearance < limit:
            limit = min(limit, stop.clearance + _overlap_at(stop, end, limit - stop.clearance))
    return limit


def _overlap_at(stop: Contact, energy: float, most: float) -> float:
    """Overlap of one stop at a contact energy, at the most ``most``."""
    if stop.energy(most) <= energy:
        return most
    return float(brentq(lambda x: stop.energy(x) - energy, 0.0, most, xtol=1e-12 * most))


def _spaced(nodes: Array) -> Array:
    """Sorted nodes without those that nearly coincide."""
    nodes = np.unique(nodes)
    gap = 1e-10 * (nodes[-1] - nodes[0])
    keep = [nodes[0], *(b for a, b in pairwise(nodes) if b - a > gap)]
    return np.array(keep)
