"""Densities of one or two displacements and momenta from an expansion."""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

import numpy as np

from averaging.phase_space.equation.elimination import Expansion
from averaging.phase_space.equation.frame import Frame
from averaging.phase_space.equation.others import raised
from averaging.phase_space.moments import moments
from fpk.arrays import Array
from fpk.observable import Coordinate, Observable

REACH = 9.0
"""Half-width of the support of a density in its standard deviations: 2e-19 of a Gaussian is out."""
PANELS = {1: 16, 2: 10}
"""Panels of an axis that no stop divides, by the number of axes."""
STOP_PANELS = 8
"""Panels between two stops and beyond one, in which the density is integrated."""
LEAST_POINTS = 20
"""Least number of points of a panel at which the contact displacement is integrated out."""
POINTS_PER_WIDTH = 4.0
"""Gauss points for each standard deviation of what the contact displacement is integrated out of,
beside one for each degree: a Gaussian on 34 of its widths is exact to round-off with 137."""
MOST_POINTS = 4000
"""Most of them: a mass tied to the contact mass by a spring 1e5 times as stiff as the others needs
as many; the certificate holds what fewer than needed leave."""


@dataclass(frozen=True)
class Form:
    """A coordinate as ``offset + slope y + direction·ζ``, ζ = C⁻¹ z, in its own unit."""

    offset: float
    slope: float
    direction: Array


def form_of(frame: Frame, expansion: Expansion, c: Coordinate) -> Form:
    """Return a displacement or momentum in terms of y and ζ."""
    reference, C = expansion.basis.reference, expansion.factor
    j, root = frame.order.index(c.row), float(np.sqrt(frame.system.mass[c.row]))
    nothing = np.zeros(C.shape[0])
    if c.kind == "p":
        return Form(0.0, 0.0, root * C[j])
    if j == 0:
        return Form(0.0, 1.0 / root, nothing)
    offset, slope = reference.offset[j - 1] / root, reference.slope[j - 1] / root
    return Form(float(offset), float(slope), C[frame.n + j - 1] / root)


def marginal(
    frame: Frame, expansion: Expansion, observable: Observable, *, share: float = 1.0
) -> tuple[tuple[Array, ...], Callable[..., Array]]:
    """Return panels and the density of one or two of (q, p), a function of one array per axis.

    ``share`` is that of the points at which the contact displacement is integrated out, where it is
    not observed: with fewer than all, the difference shows their error.
    """
    forms = [form_of(frame, expansion, c) for c in observable]
    contact = [not np.any(f.direction) for f in forms]
    panels = tuple(
        f.slope * expansion.basis.fine_nodes(STOP_PANELS)
        if alone
        else _panels(frame, expansion, c, len(forms))
        for f, c, alone in zip(forms, observable, contact, strict=True)
    )
    if contact[-1] and len(forms) == 2:
        pdf = _density(expansion, [forms[1], forms[0]], share)
        return panels, lambda a, b: pdf(b, a)
    return panels, _density(expansion, forms, share)


def _panels(frame: Frame, expansion: Expansion, c: Coordinate, axes: int) -> Array:
    m, n = moments(frame, expansion), frame.n
    at = frame.order.index(c.row) + (n if c.kind == "p" else 0)
    root = np.sqrt(frame.system.mass[c.row])
    unit = root if c.kind == "p" else 1.0 / root
    reach = REACH * np.sqrt(m.covariance[at, at])
    return np.asarray(unit * (m.mean[at] + np.linspace(-reach, reach, PANELS[axes] + 1)))


def _density(expansion: Expansion, forms: list[Form], share: float) -> Callable[..., Array]:
    """Return the density of forms; the contact displacement, if among them, comes first."""
    b = expansion.basis
    known = not np.any(forms[0].direction)
    linear = forms[1:] if known else forms
    # Orthonormal directions: x_a = o_a + s_a y + Σ_b L_ab t_b, t_b = e_b·ζ.
    if linear:
        Q, R = np.linalg.qr(np.stack([f.direction for f in linear], axis=1))
        signs = np.sign(np.diag(R))
        directions, L = (Q * signs).T, (R * signs[:, None]).T
    else:
        directions, L = np.zeros((0, expansion.factor.shape[0])), np.zeros((0, 0))
    coefficients = _projected(expansion, directions)

    def given(y: Array) -> Array:
        """Coefficients of the polynomials in t, given y (points,), times w(y)."""
        values, _ = b.functions(y)
        return np.asarray(coefficients @ values.T * b.density(y))

    if known:
        slope = forms[0].slope

        def joint(x: Array, *others: Array) -> Array:
            y = np.asarray(x, dtype=float) / slope
            inside = (y >= b.nodes[0]) & (y <= b.nodes[-1])
            flat = given(np.clip(y, b.nodes[0], b.nodes[-1]).ravel())
            c = flat.reshape((*coefficients.shape[:-1], *y.shape)) * np.where(inside, 1.0, 0.0)
            t = _standardised(linear, L, y, others)
            return np.asarray(_series(c, t) / (slope * np.prod(np.diag(L))))

        return joint

    widths = [L[a, a] / abs(f.slope) for a, f in enumerate(linear) if f.slope]
    width = min([b.reference.weight[1] ** -0.5, *widths])
    longest = float(np.max(np.diff(b.nodes)))
    count = POINTS_PER_WIDTH * longest / width + len(expansion.levels) + LEAST_POINTS
    y, w = b.rule(ceil(share * min(count, MOST_POINTS)))
    c = given(y) * w
    if not any(f.slope for f in linear):
        y, c = np.zeros(1), c.sum(axis=-1, keepdims=True)

    def integrated(*x: Array) -> Array:
        at = [np.asarray(a, dtype=float)[..., None] for a in x]
        t = _standardised(linear, L, y, at)
        spread = c.reshape(*c.shape[:-1], *(1,) * (at[0].ndim - 1), y.size)
        return np.asarray(_series(spread, t).sum(axis=-1) / np.prod(np.diag(L)))

    return integrated


def _standardised(
    forms: list[Form], L: Array, y: Array, x: "tuple[Array, ...] | list[Array]"
) -> list[Array]:
    """t of the coordinates x given y: L t = x − o − s y."""
    t: list[Array] = []
    for a, (f, value) in enumerate(zip(forms, x, strict=True)):
        left = value - f.offset - f.slope * y
        for b in range(a):
            left = left - L[a, b] * t[b]
        t.append(left / L[a, a])
    return t


def _series(c: Array, t: list[Array]) -> Array:
    """Σ c_nm… He_n(t₁)/√n! He_m(t₂)/√m! … times the standard normal density of t.

    The indices of ``c`` come first, the axes of t after them. The sum over n is taken where t₁ is,
    before it meets the axes of t₂.
    """
    if not t:
        return c
    phi = np.exp(-0.5 * t[0] ** 2) / np.sqrt(2.0 * np.pi)
    before, now = np.zeros_like(phi), phi
    total = c[0] * now
    for n in range(1, c.shape[0]):
        before, now = now, (t[0] * now - np.sqrt(n - 1.0) * before) / np.sqrt(n)
        total = total + c[n] * now
    return _series(total, t[1:])


def _projected(expansion: Expansion, directions: Array) -> Array:
    """Coefficients of He_n(e₁·ζ)/√n! (He_m(e₂·ζ)/√m!), (n + 1, …, functions of all panels).

    All other directions are integrated out. A polynomial of level n is a combination v of those of
    all k of the level, v = Σ_i e_i a_i⁺ v/√n of the level below.
    """
    others, total = expansion.others, len(expansion.levels) - 1
    in_panels = [expansion.of_panels(n) for n in range(total + 1)]

    def function(v: Array, n: int) -> Array:
        return np.asarray(v @ in_panels[n])

    start = np.ones(1)
    size = in_panels[0].shape[1]
    if len(directions) == 0:
        return function(start, 0)
    if len(directions) == 1:
        rows = [function(start, 0)]
        v = start
        for n in range(total):
            v = raised(others, n, v, directions[0]) / np.sqrt(n + 1.0)
            rows.append(function(v, n + 1))
        return np.array(rows)
    out = np.zeros((total + 1, total + 1, size))
    first = start
    for n in range(total + 1):
        v = first
        for m in range(total + 1 - n):
            out[n, m] = function(v, n + m)
            if n + m < total:
                v = raised(others, n + m, v, directions[1]) / np.sqrt(m + 1.0)
        if n < total:
            first = raised(others, n, first, directions[0]) / np.sqrt(n + 1.0)
    return out
