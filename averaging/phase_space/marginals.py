"""Moments of an expansion, and its densities of one or two displacements and momenta."""

from collections.abc import Callable, Sequence
from math import ceil

import numpy as np

from averaging.phase_space.equation.degrees import combined
from averaging.phase_space.equation.elimination import Expansion
from fpk.answer.names import Coordinate, Observable
from fpk.numeric.arrays import Array
from fpk.numeric.quadrature import GAUSS_RULES

SPAN = 18
"""Width of the support of a density in its standard deviations: 2e-19 of a Gaussian is out."""
PANELS = {1: 16, 2: 10}
"""Panels of an axis that no stop divides, by the number of axes; half as many beside stops."""
POINTS_PER_WIDTH = 4.0
"""Gauss points for each standard deviation of what the contact displacement is integrated out of,
beside one a degree: 137 integrate a Gaussian on 34 of its widths to round-off."""
MOST_POINTS = 4000
"""Most of them, as a spring 1e5 times as stiff needs; the certificate holds what is left."""


def moments(e: Expansion) -> tuple[Array, Array]:
    """Return the mean (2n,) and covariance (2n, 2n) of (y, r, v), from the three lowest levels."""
    b, C, y, (one, two) = e.basis, e.factor, e.basis.points, e.space.first_and_second
    u0, u1, u2 = (b.weights * e.functions(level, y) for level in range(3))
    # Means of (y, v, x) and of their products; then of (y, r, v).
    mean = np.concatenate([u0 @ y, C @ one @ u1.sum(axis=1)])
    second = np.zeros(2 * mean.shape)
    second[0, 0], second[0, 1:] = u0[0] @ y**2, C @ one @ (u1 @ y)
    second[1:, 0] = second[0, 1:]
    second[1:, 1:] = C @ (np.eye(len(C)) + two @ u2.sum(axis=1)) @ C.T
    to, shift = b.reference.to_state
    covariance = to @ (second - np.outer(mean, mean)) @ to.T
    return to @ mean + shift, 0.5 * (covariance + covariance.T)


def form_of(e: Expansion, c: Coordinate) -> tuple[float, float, Array]:
    """Return a displacement or momentum as offset + slope y + direction·ζ, ζ = C⁻¹ z."""
    at, unit = e.basis.frame.place(c)
    to, shift = e.basis.reference.to_state
    return unit * shift[at], unit * to[at, 0], unit * (to[at, 1:] @ e.factor)


def marginal(
    e: Expansion, observable: Observable, *, share: float = 1.0
) -> tuple[tuple[Array, ...], Callable[..., Array]]:
    """Return panels and the density of one or two of (q, p), a function of one array per axis.

    ``share``: of the points at which the contact displacement is integrated out.
    """
    (mean, covariance), panels = moments(e), list[Array]()
    forms = [form_of(e, c) for c in observable]
    for (_, slope, direction), c in zip(forms, observable, strict=True):
        at, unit = e.basis.frame.place(c)
        reach = 0.5 * SPAN * np.sqrt(covariance[at, at])
        nodes = unit * (mean[at] + np.linspace(-reach, reach, PANELS[len(forms)] + 1))
        if contact := not np.any(direction):
            parts = [panel.parts(PANELS[1] // 2) for panel in e.basis.panels]
            nodes = slope * np.unique(np.concatenate(parts))
        panels.append(nodes)
    if contact and len(forms) == 2:
        pdf = _density(e, forms[::-1], share)
        return tuple(panels), lambda a, b: pdf(b, a)
    return tuple(panels), _density(e, forms, share)


def _density(
    e: Expansion, forms: list[tuple[float, float, Array]], share: float
) -> Callable[..., Array]:
    """Return the density of forms; the contact displacement, if among them, comes first."""
    b = e.basis
    known = not np.any(forms[0][2])
    linear = forms[1:] if known else forms
    # Orthonormal directions: x_a = o_a + s_a y + Σ_b L_ab t_b, t_b = e_b·ζ.
    along = np.array([direction for _, _, direction in linear]).reshape(-1, len(e.factor))
    Q, R = np.linalg.qr(along.T)
    signs = np.sign(np.diag(R))
    directions, L = (Q * signs).T, (R * signs[:, None]).T
    coefficients, scale = _projected(e, directions), float(np.prod(np.diag(L)))

    def given(y: Array) -> Array:
        """Coefficients of the polynomials in t, given y (points,), times w(y)."""
        values, _ = b.functions(y)
        return np.asarray(coefficients @ values.T * b.density(y))

    def summed(c: Array, y: Array, x: Sequence[Array]) -> Array:
        """Σ c_nm He_n(t₁)/√n! He_m(t₂)/√m! N(t), L t = x − o − s y."""
        t: list[Array] = []
        for a, ((offset, slope, _), value) in enumerate(zip(linear, x, strict=True)):
            rest = value - offset - slope * y - sum(L[a, k] * t[k] for k in range(a))
            t.append(rest / L[a, a])
        # The sum over n is taken where t₁ is, before it meets the axes of t₂.
        for s in t:
            before, now = np.zeros_like(s), np.exp(-0.5 * s**2) / np.sqrt(2.0 * np.pi)
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

    widths = [L[a, a] / abs(slope) for a, (_, slope, _) in enumerate(linear) if slope]
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


def _projected(e: Expansion, directions: Array) -> Array:
    """Coefficients of He_n(e₁·ζ)/√n! (He_m(e₂·ζ)/√m!), (n + 1, …, functions of all panels).

    A polynomial of level n is a combination v of its k, v = Σ_i e_i a_i⁺ v/√n of the level below.
    """
    in_panels = [e.of_panels(n) for n in range(len(e.levels))]
    raising = [combined(e.space.up, direction) for direction in directions]
    out = np.zeros((*[len(e.levels)] * len(raising), in_panels[0].shape[1]))

    def add(place: tuple[int, ...], v: Array) -> None:
        """Fill in what follows from the combination v of the orders in ``place``."""
        n, axis = sum(place), len(place)
        if axis == len(raising):
            out[place] = v[e.space.span(n)] @ in_panels[n]
            return
        for m in range(len(e.levels) - n):
            add((*place, m), v)
            v = raising[axis] @ v / np.sqrt(m + 1.0)

    add((), np.eye(e.space.level.size, 1)[:, 0])
    return out
