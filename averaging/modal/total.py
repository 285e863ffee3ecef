"""The density of a sum of modal energies, where damping that depends on the state couples them."""

from collections.abc import Callable, Sequence
from functools import reduce

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from averaging.modal.blocks import EnergyDensity, joined_checks
from fpk.quadrature import gauss_legendre, panel_rule

Array = NDArray[np.float64]

POINTS = 16
"""Gauss points per panel of the sum, which is expanded in Legendre polynomials there."""
ALONG = 20
"""Gauss points per panel of the integral along H1 + H2 = H, where p is a product of polynomials."""
MOST_ROUNDS = 12
CHUNK = 2_000_000


def total_energy_of(blocks: Sequence[EnergyDensity], *, tol: float) -> EnergyDensity:
    """Return p(H) of H = Σ H_i over independent groups of one or two energies.

    p(H) = ∫p(H1, H − H1) dH1 within a group, and convolutions between groups; each is expanded
    panel by panel, halved until its last coefficients fall below a share of ``tol``.
    """
    share = tol / (2 * len(blocks))
    lines = [block if len(block.panels) == 1 else _within(block, share) for block in blocks]
    return reduce(lambda a, b: _convolved(a, b, share), lines)


def _within(block: EnergyDensity, tol: float) -> EnergyDensity:
    return _expanded(block.panels, block.values, tol, [block])


def _convolved(first: EnergyDensity, second: EnergyDensity, tol: float) -> EnergyDensity:
    def values(x: Array, y: Array) -> Array:
        (p, p_error), (r, r_error) = first.values(x), second.values(y)
        return np.stack([p * r, p_error * np.abs(r) + np.abs(p) * r_error])

    return _expanded(first.panels + second.panels, values, tol, [first, second])


def _expanded(
    panels: tuple[Array, ...],
    joint: Callable[[Array, Array], Array],
    tol: float,
    parts: Sequence[EnergyDensity],
) -> EnergyDensity:
    """Expand ∫joint(x, H − x) dx in Legendre polynomials, p and its error alike."""
    t, w = gauss_legendre(POINTS)
    degrees = np.arange(POINTS)
    project = w[:, None] * legendre.legvander(t, POINTS - 1) * (degrees + 0.5)

    def coefficients(left: Array, right: Array) -> Array:
        energy = 0.5 * (left + right)[:, None] + 0.5 * (right - left)[:, None] * t
        found = _along(panels, joint, energy.ravel()).reshape(2, *energy.shape)
        return np.asarray(found @ project)

    end = panels[0][-1] + panels[1][-1]
    ends = np.array([panels[0][-1], panels[1][-1], end])
    nodes = np.unique(np.concatenate([*panels, np.linspace(0.0, end, 9), ends]))
    nodes = nodes[np.append(True, np.diff(nodes) > 1e-12 * end)]
    left, right = nodes[:-1], nodes[1:]
    found = coefficients(left, right)
    for _ in range(MOST_ROUNDS):
        rest = (right - left) * np.sum(np.abs(found[0, :, -2:]), axis=1)
        marked = rest > 0.5 * tol / left.size
        if rest.sum() <= 0.5 * tol or not marked.any():
            break
        middle = 0.5 * (left + right)[marked]
        new = (np.append(left[marked], middle), np.append(middle, right[marked]))
        left, right = np.append(left[~marked], new[0]), np.append(right[~marked], new[1])
        found = np.concatenate([found[:, ~marked], coefficients(*new)], axis=1)
        order = np.argsort(left)
        left, right, found = left[order], right[order], found[:, order]
    rest = (right - left) * np.sum(np.abs(found[0, :, -2:]), axis=1)
    nodes = np.append(left, right[-1])
    local = np.sum(np.abs(found[0, :, -2:]), axis=1)

    def values(energy: Array) -> Array:
        x = np.asarray(energy, dtype=float)
        flat = x.ravel()
        k = np.clip(np.searchsorted(nodes, flat, side="right") - 1, 0, nodes.size - 2)
        s = (2.0 * flat - nodes[k] - nodes[k + 1]) / (nodes[k + 1] - nodes[k])
        both = np.einsum("xj,cxj->cx", legendre.legvander(s, POINTS - 1), found[:, k])
        both = np.stack([both[0], np.abs(both[1]) + local[k]])
        inside = (flat >= 0.0) & (flat <= end)
        return np.where(inside, both, 0.0).reshape(2, *x.shape)

    error = sum(part.l1_error for part in parts) + 2.0 * float(rest.sum())
    checks = joined_checks([part.certificate for part in parts])
    return EnergyDensity((nodes,), values, error, checks)


def _along(
    panels: tuple[Array, ...], joint: Callable[[Array, Array], Array], energy: Array
) -> Array:
    """∫joint(x, H − x) dx over 0 < x < H, cut where x or H − x passes from panel to panel."""
    total = np.empty((2, energy.size))
    cuts = panels[0].size + panels[1].size
    step = max(CHUNK // (ALONG * cuts), 1)
    for start in range(0, energy.size, step):
        H = energy[start : start + step, None]
        ends = np.concatenate([np.minimum(panels[0], H), np.maximum(H - panels[1], 0.0)], axis=1)
        ends = np.sort(np.clip(ends, 0.0, np.minimum(H, panels[0][-1])), axis=1)
        t, w = panel_rule(np.array([0.0, 1.0]), ALONG)
        length = np.diff(ends, axis=1)[:, :, None]
        x = ends[:, :-1, None] + length * t
        y = np.clip(H[:, :, None] - x, 0.0, None)
        total[:, start : start + step] = np.sum(joint(x, y) * (length * w), axis=(2, 3))
    return total
