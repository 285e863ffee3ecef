"""Systems that the tests of averaging share, and shell integrals independent of the code."""

from itertools import pairwise

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import beta

from averaging.shell.averages import shell_averages
from fpk.numeric.quadrature import panel_rule
from fpk.system.contact import Contact
from fpk.system.system import System


def fig6(contacts=(), *, mass=(1.0, 1.0)):
    """The system of Fig. 6; α = 0.12/0.03 = 4 for unit masses."""
    return System(mass, [1.0, 1.0], [0.08, 0.04], [0.01, 0.02], contacts=contacts)


def exact_system(contacts=(), *, mass=(1.0, 2.0), h=2.0):
    """Damping in proportion to the noise, c_i = h D_i: condition (8) holds."""
    D = np.array([0.1, 0.2])
    return System(mass, [1.0, 1.5], h * D, D, contacts=contacts)


def chain(n, contacts=()):
    """n unit masses and springs: k_eff of the last mass is 1/n."""
    return System(np.ones(n), np.ones(n), np.full(n, 0.1), np.full(n, 0.05), contacts=contacts)


def both(stiffness, clearance=0.5, *, mass=1, law="hertz", exponent=None):
    return (Contact(mass + 1, "both", stiffness, clearance, law, exponent),)


TWO_MASSES = (Contact(1, "both", 5.0, 0.3), Contact(2, "both", 10.0, 0.5))
SKEW = (Contact(1, "right", 3.0, 0.2, "bilinear"), Contact(2, "left", 20.0, 0.4))


def shell_integral(k, stops, energy, exponent):
    """∫(H − V)^exponent dq for V = ½ k q² + U(q), by scipy; ``stops`` are (δ, B, e) or None.

    Differences H − V are formed from the turning point, so nothing cancels.
    """
    return sum(_one_side(k, stop, energy, exponent) for stop in stops)


def _one_side(k, stop, energy, exponent):
    reach = np.sqrt(2.0 * energy / k)
    if stop is None or stop[0] >= reach:
        half = 0.5 * np.sqrt(2.0 / k) * beta(0.5, exponent + 1.0)
        return half * energy ** (exponent + 0.5)
    clearance, B, e = stop
    left = energy - 0.5 * k * clearance**2

    def rise(x):
        return x * (k * clearance + 0.5 * k * x + B / (e + 1.0) * x**e) - left

    X = brentq(rise, 0.0, reach, xtol=1e-300, rtol=4.0 * np.finfo(float).eps)

    def free(s):  # q = δ (1 − s²)
        rest = left + 0.5 * k * clearance**2 * s * s * (2.0 - s * s)
        return rest**exponent * 2.0 * clearance * s

    def touching(s):  # q = δ + X − y, y = X s²
        y = X * s * s
        springs = k * y * (clearance + X - 0.5 * y)
        contact = -B / (e + 1.0) * X ** (e + 1.0) * np.expm1((e + 1.0) * np.log1p(-s * s))
        return (springs + contact) ** exponent * 2.0 * X * s

    total = _integral(touching, [0.0, 0.5, 1.0])
    if clearance > 0.0:
        # A boundary layer of the width √(left/(k δ²)) at first touch.
        layer = min(0.3, np.sqrt(left / (k * clearance**2)))
        total += _integral(free, [0.0, layer, min(1.0, 10.0 * layer), 1.0])
    return total


def _integral(function, ends):
    return sum(
        quad(function, a, b, epsabs=0.0, epsrel=1e-13, limit=400)[0]
        for a, b in pairwise(ends)
        if b > a
    )


def integral(function, nodes, *, points=24):
    x, w = panel_rule(np.asarray(nodes, dtype=float), points)
    return float(np.sum(w * function(x)))


def term_power(system):
    """Return the power of the damping terms and its error, as a function of the energies."""
    return lambda energy: shell_averages(system, energy)[4:]
