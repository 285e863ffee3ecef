"""Quadrature and root finding for the references of the attack; nothing of the product is used."""

import numpy as np

STEP = 1.0 / 32.0
"""Step of the double exponential rule: half the width of a Gaussian cut at 50 nats."""
_T = np.arange(-4.0, 4.0 + STEP / 2, STEP)
_S = 0.5 * np.pi * np.sinh(_T)
FRACTION = 1.0 / (1.0 + np.exp(-2.0 * _S))  # of the piece, with full accuracy near 0
WEIGHT = STEP * 0.25 * np.pi * np.cosh(_T) / np.cosh(_S) ** 2

# Gauss-Kronrod 10-21 on (-1, 1), from QUADPACK.
_K = np.array([
    0.995657163025808080735527280689003, 0.973906528517171720077964012084452,
    0.930157491355708226001207180059508, 0.865063366688984510732096688423493,
    0.780817726586416897063717578345042, 0.679409568299024406234327365114874,
    0.562757134668604683339000099272694, 0.433395394129247190799265943165784,
    0.294392862701460198131126603103866, 0.148874338981631210884826001129720,
])  # fmt: skip
_WK = np.array([
    0.011694638867371874278064396062192, 0.032558162307964727478818972459390,
    0.054755896574351996031381300244580, 0.075039674810919952767043140916190,
    0.093125454583697605535065465083366, 0.109387158802297641899210590325805,
    0.123491976262065851077958109585166, 0.134709217311473325928054001771707,
    0.142775938577060080797094273138717, 0.147739104901338491374841515972068,
])  # fmt: skip
_WG = np.array([
    0.066671344308688137593568809893332, 0.149451349150580593145863396957697,
    0.219086362515982043995534934228163, 0.269266719309996355091226921569469,
    0.295524224714752870173815619188769,
])  # fmt: skip
KRONROD = np.concatenate([-_K, [0.0], _K[::-1]])
KRONROD_WEIGHT = np.concatenate([_WK, [0.149445554002916905664936468389821], _WK[::-1]])
GAUSS_WEIGHT = np.zeros(21)
GAUSS_WEIGHT[1::2] = np.concatenate([_WG, _WG[::-1]])


def pieces(f, cuts):
    """∫f over the pieces between ``cuts`` (..., m + 1), ascending; ``f`` takes (..., m, nodes).

    The double exponential rule takes any integrable singularity at the cuts.
    """
    left, length = cuts[..., :-1, None], np.diff(cuts, axis=-1)[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        values = f(left + length * FRACTION) * (length * WEIGHT)
    return np.sum(np.where(length > 0.0, values, 0.0), axis=(-2, -1))


def adaptive(f, cuts, *, rtol=1e-12, rounds=30):
    """∫f(owner, x) dx for each row of ``cuts`` (rows, m + 1) by Gauss-Kronrod with bisection.

    Each piece is traversed as a + (b − a) sin²: square roots at its ends become smooth. Returns
    the integrals and estimates of their errors.
    """
    rows = cuts.shape[0]
    owner = np.repeat(np.arange(rows), cuts.shape[1] - 1)
    start, length = cuts[:, :-1].ravel(), np.diff(cuts, axis=1).ravel()
    keep = length > 0.0
    owner, start, length = owner[keep], start[keep], length[keep]
    low, high = np.zeros(owner.size), np.ones(owner.size)
    total, error = np.zeros(rows), np.zeros(rows)
    for k in range(rounds):
        half = 0.5 * (high - low)[:, None]
        t = 0.5 * (high + low)[:, None] + half * KRONROD
        x = start[:, None] + length[:, None] * np.sin(0.5 * np.pi * t) ** 2
        y = f(owner, x) * (length[:, None] * 0.5 * np.pi * np.sin(np.pi * t))
        value = (half * y) @ KRONROD_WEIGHT
        difference = np.abs((half * y) @ (KRONROD_WEIGHT - GAUSS_WEIGHT))
        # The 21 points are far better than the 10: as in QUADPACK the power 3/2 of the difference.
        mean = value[:, None] / (2.0 * half)
        spread = (half * np.abs(y - mean)) @ KRONROD_WEIGHT + 1e-300
        doubt = spread * np.minimum(1.0, (200.0 * difference / spread) ** 1.5)
        whole = total + np.bincount(owner, np.abs(value), rows)
        bad = (doubt > 0.02 * rtol * whole[owner]) & (half[:, 0] > 1e-9) & (k < rounds - 1)
        total += np.bincount(owner[~bad], value[~bad], rows)
        error += np.bincount(owner[~bad], doubt[~bad], rows)
        if not bad.any():
            break
        middle = 0.5 * (low + high)[bad]
        low, high = np.append(low[bad], middle), np.append(middle, high[bad])
        owner, start, length = (np.tile(part[bad], 2) for part in (owner, start, length))
    return total, error


def increasing_root(f, low, high, *, steps=90):
    """Root of an increasing function between arrays ``low`` and ``high``, by bisection."""
    low, high = np.array(low, dtype=float), np.array(high, dtype=float)
    for _ in range(steps):
        middle = 0.5 * (low + high)
        below = f(middle) < 0.0
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return 0.5 * (low + high)


def distance_to_level(f, scale, *, steps=90):
    """Least x >= 0 with f(x) >= 0 for an f that increases from f(0) <= 0, scales in ``scale``."""
    high = np.array(scale, dtype=float)
    for _ in range(400):
        short = f(high) < 0.0
        if not short.any():
            break
        high = np.where(short, 2.0 * high, high)
    return increasing_root(f, np.zeros_like(high), high, steps=steps)
