"""Moments of an expansion, and its densities of one or two displacements and momenta."""

from collections.abc import Callable, Sequence
from functools import singledispatch
from math import ceil
from typing import Any

import numpy as np

from averaging.conditional import MOST_POINTS
from averaging.gaussian import GAUSSIAN_REACH
from averaging.phase_space.equation.degrees import combination
from averaging.phase_space.equation.elimination import Expansion
from averaging.phase_space.equation.frame import POWER
from fpk.answer.names import Coordinate, Observable
from fpk.numeric.arrays import Array
from fpk.numeric.quadrature import GAUSS_RULES

AXIS_PANELS = {1: 16, 2: 10}
"""Panels of an axis of a marginal density, by the number of its axes. The contact displacement has
instead half of the first number on each panel of the basis."""
POINTS_PER_WIDTH = 4.0
"""Gauss points per conditional standard deviation of the contact displacement, beside a point for
each degree: 137 points integrate a Gaussian over 34 standard deviations to round-off."""


@singledispatch
def moments(e: Any) -> tuple[Array, Array]:
    """Return mean (2n,) and covariance (2n, 2n) of (y, r, v), see ``Frame``.

    ``e`` is an ``Expansion`` or another solution that is registered.
    """
    b, C, y = e.basis, e.factor, e.basis.points
    p, first, products = map(e.given, e.space.first_moments)
    # First and second moments of (y, v, x); then of (y, r, v).
    mean = np.concatenate([[p @ y], C @ first.sum(axis=1)])
    mixed, square = (C @ first @ y)[:, None], np.atleast_2d(p @ y**2)
    second = np.block([[square, mixed.T], [mixed, C @ products.sum(axis=2) @ C.T]])
    to, shift = b.reference.to_state
    covariance = to @ (second - np.outer(mean, mean)) @ to.T
    return to @ mean + shift, 0.5 * (covariance + covariance.T)


def linear_form(e: Expansion, c: Coordinate) -> tuple[float, float, Array]:
    """Return offset, slope, direction of ``c`` (q or p) = offset + slope y + direction·ζ.

    y and z = C ζ are the variables of ``Reference``.
    """
    at, unit = e.basis.frame.place(c)
    to, shift = e.basis.reference.to_state
    return unit * shift[at], unit * to[at, 0], unit * (to[at, 1:] @ e.factor)


@singledispatch
def marginal(
    e: Any, observable: Observable, *, share: float = 1.0
) -> tuple[tuple[Array, ...], Callable[..., Array]]:
    """Return panels and the density of one or two of (q, p), a function of one array per axis.

    ``e`` is an ``Expansion`` or another solution that is registered; ``share`` multiplies the
    number of points of the integral over what is not observed.
    """
    raise TypeError(type(e))


@marginal.register
def _(
    e: Expansion, observable: Observable, *, share: float = 1.0
) -> tuple[tuple[Array, ...], Callable[..., Array]]:
    (mean, covariance), panels = moments(e), list[Array]()
    forms = [linear_form(e, c) for c in observable]
    for (_, slope, direction), c in zip(forms, observable, strict=True):
        at, unit = e.basis.frame.place(c)
        reach = GAUSSIAN_REACH * np.sqrt(covariance[at, at])
        nodes = unit * (mean[at] + np.linspace(-reach, reach, AXIS_PANELS[len(forms)] + 1))
        if contact := not np.any(direction):
            parts = [panel.parts(AXIS_PANELS[1] // 2) for panel in e.basis.panels]
            nodes = slope * np.unique(np.concatenate(parts))
        panels.append(nodes)
    if contact and len(forms) == 2:
        pdf = _marginal_density(e, forms[::-1], share)
        return tuple(panels), lambda a, b: pdf(b, a)
    return tuple(panels), _marginal_density(e, forms, share)


def _marginal_density(
    e: Expansion, forms: list[tuple[float, float, Array]], share: float
) -> Callable[..., Array]:
    """Return the density of ``forms``, each as ``linear_form`` returns it.

    The contact displacement must be the first if it is one of two. ``share``: see ``marginal``.
    """
    b = e.basis
    known = not np.any(forms[0][2])
    linear = forms[1:] if known else forms
    # Orthonormal directions: x_a = o_a + s_a y + Σ_b L_ab t_b, t_b = e_b·ζ.
    along = np.array([direction for _, _, direction in linear]).reshape(-1, len(e.factor))
    Q, R = np.linalg.qr(along.T)
    signs = np.sign(np.diag(R))
    directions, L = (Q * signs).T, (R * signs[:, None]).T
    # N(0; 0, 1/σ)^−1 for each t, times the Jacobian.
    scale = float(np.prod(np.sqrt(2.0 * np.pi / POWER) * np.diag(L)))
    coefficients = _projections(e, directions)

    def given(y: Array) -> Array:
        """Return w(``y``)^σ times the coefficients of the polynomials in t.

        They are (orders, points), or (orders, orders, points) for two linear forms.
        """
        values, _ = b.functions(y)
        return np.asarray(coefficients @ values.T * b.density(y))

    def summed(c: Array, y: Array, x: Sequence[Array]) -> Array:
        """Return Σ ``c``_nm He_n(t₁)/√n! He_m(t₂)/√m! N(t; 0, 1/σ)/det L, L t = ``x`` − o − s y.

        Here y is ``y``, and σ ``POWER``.
        """
        t: list[Array] = []
        for a, ((offset, slope, _), value) in enumerate(zip(linear, x, strict=True)):
            rest = value - offset - slope * y - sum(L[a, k] * t[k] for k in range(a))
            t.append(rest / L[a, a])
        # The sum over n is taken first, on the shape of t₁, before that of t₂ enters.
        for s in t:
            before, now = np.zeros_like(s), np.exp(-0.5 * POWER * s**2)
            total = c[0] * now
            for n in range(1, len(c)):
                before, now = now, (s * now - np.sqrt(n - 1.0) * before) / np.sqrt(n)
                total = total + c[n] * now
            c = total
        return c / scale

    if known:
        scale *= forms[0][1]

        def joint(x: Array, *others: Array) -> Array:
            y = np.asarray(x, dtype=float) / forms[0][1]
            inside = np.clip(y, b.nodes[0], b.nodes[-1])
            c = given(inside.ravel()).reshape((*coefficients.shape[:-1], *y.shape))
            return np.asarray(summed(c * (y == inside), y, others))

        return joint

    widths = [
        L[a, a] / np.sqrt(POWER) / abs(slope) for a, (_, slope, _) in enumerate(linear) if slope
    ]
    width = min([b.reference.weight[1] ** -0.5, *widths])
    longest = float(np.max(np.diff(b.nodes)))
    count = POINTS_PER_WIDTH * longest / width + len(e.levels) + GAUSS_RULES[1][-1]
    rules = [panel.rule(ceil(share * min(count, MOST_POINTS))) for panel in b.panels]
    y, w = map(np.concatenate, zip(*rules, strict=True))
    c = given(y) * w
    if not any(slope for _, slope, _ in linear):
        y, c = np.zeros(1), c.sum(axis=-1, keepdims=True)

    def integrated(*x: Array) -> Array:
        at = [np.asarray(a, dtype=float)[..., None] for a in x]
        spread = c.reshape(*c.shape[:-1], *(1,) * (at[0].ndim - 1), y.size)
        return np.asarray(summed(spread, y, at).sum(axis=-1))

    return integrated


def _projections(e: Expansion, directions: Array) -> Array:
    """Return the coefficients of He_n(e₁·ζ)/√n! (times He_m(e₂·ζ)/√m!), the e's ``directions``.

    They are integrals over the components of ζ orthogonal to these, (levels, [levels,] functions of
    all panels): combinations v_n of the coefficients of the He_k, v_n = Σ_i e_i a_i⁺ v_(n−1)/√n.
    """
    raising = [combination(e.space.up, direction) for direction in directions]
    out = np.zeros((*[len(e.levels)] * len(raising), e.in_panels.shape[1]))

    def add(place: tuple[int, ...], v: Array) -> None:
        """Write into ``out`` the entries of all (n, …) that begin with ``place``.

        ``v`` (degrees,) is the combination of the He_k for the orders ``place``.
        """
        n, axis = sum(place), len(place)
        if axis == len(raising):
            out[place] = v @ e.in_panels
            return
        for m in range(len(e.levels) - n):
            add((*place, m), v)
            v = raising[axis] @ v / np.sqrt(m + 1.0)

    add((), e.space.integral(directions))
    return out
