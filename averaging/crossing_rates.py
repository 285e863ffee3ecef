"""Rates at which displacements cross levels, from a density of the energy."""

from math import pi

from averaging.back_transformation import back_transformed, integration_error, marginal_of
from averaging.weyl import StateDensity
from fpk.arrays import Array
from fpk.dynamics import Curve, certified_curve
from fpk.observable import Coordinate


def crossing_rates(source: StateDensity, row: int, at: Array, *, tol: float) -> Curve:
    """Return the upcrossings per unit time of the levels ``at`` by q of mass ``row`` (of 0).

    Rice's ∫_0^∞ v f(q, p) dp, v = p/m, of a density of the energy is its integral over p²/2m: a
    Weyl integral of half an order above that of p(q). The scale is σ_v/(2πσ_q).
    """
    observable, mass = (Coordinate("q", row),), float(source.system.mass[row])
    q = back_transformed(source, observable, tol=tol)
    p = back_transformed(source, (Coordinate("p", row),), tol=tol)
    flux = marginal_of(source, observable, flux_of=mass)
    values = flux(at)
    errors = flux(at, part="error") + integration_error(source, observable, flux, values, at)
    scale = p.std().value / mass / (2.0 * pi * q.std().value)
    return certified_curve(values, errors, scale=scale, of=q, tol=tol)
