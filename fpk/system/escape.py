"""Escape: damping terms that feed energy in without bound, so that no density is stationary."""

from collections.abc import Callable

import numpy as np
from threadpoolctl import threadpool_limits

from fpk.numeric.arrays import ROUND_OFF, Array
from fpk.numeric.errors import NotApplicable
from fpk.system.ends import MAX_ENERGY
from fpk.system.equivalent import SEARCHED
from fpk.system.linear import natural_modes
from fpk.system.system import System

LEVEL = 1e8
"""Energy of the starts, in units of the highest energy at which any two rates of damping and
vibration are equal: there rates differ by a factor of 1e4 for each degree between them."""
DRAWN, FOLLOWED = 4096, 64
"""Number of random states at the energy of the starts, so many that a cone of a thousandth of the
shell gets some, and largest number of motions that are integrated from them. For more than two
masses these are 128/n, but at least 8, as each step takes the eigenvalues of a matrix."""
STEPS = 3000
"""Largest number of time steps: with a change ``MOVED`` in each, growth by 260 powers of ten or
95 periods of a vibration."""
CHANGE, MOVED = 0.1, 0.2
"""Largest relative changes in a step: of a coordinate by the nonlinear correction, and of the whole
state or of a growing mode of the linearised motion."""
SLOW = 0.05
"""Growth rate over frequency below which implicit Euler steps may damp a vibration: whether it
gains energy over whole cycles is left to ``fpk.system.equivalent``."""
ESCAPED = 100.0
"""Energy, in units of the start, above which a motion counts as escaped unless it returns."""


def require_held(system: System) -> None:
    """Raise ``NotApplicable`` if the motion escapes, so that no density is stationary."""
    if reason := system.fact(escape):
        raise NotApplicable(reason)


def escape(system: System) -> str | None:
    """Return in words which damping term lets the motion escape, and where; None if none does.

    The motion without noise, ``M dv = −(c v + K q + g(q)) dt``, is integrated from states far out
    in which damping terms feed energy in. The sign of the power Σ c_ij v_i v_j alone decides
    nothing: van der Pol's oscillator crosses |q| < 1 at any speed. Noise reaches all these states,
    so that no density is stationary if one motion escapes.
    """
    if not system.damping_terms:
        return None
    # The unit (2n,) of each of (q, v) in which its energy is about x²/2.
    n, unit = system.n, np.sqrt([*np.diag(system.compliance), *(1.0 / system.mass)])
    # The highest energies, without and with stops, at which two rates are equal: c_ij/√(m_i m_j) of
    # the constant damping and of each term, natural frequencies, √(2E/m)/q of a rebound at q.
    root, flexibility = np.sqrt(np.outer(system.mass, system.mass)), np.diag(system.compliance)
    rates = [(0, max(np.max(np.abs(system.damping) / root), natural_modes(system)[1][-1]))]
    for t in system.damping_terms:
        size = np.prod((np.sqrt(2.0) * unit) ** [*t.powers("q", n), *t.powers("v", n)])
        rates.append((t.degree, abs(t.coefficient) / root[t.row, t.column] * size))
    with np.errstate(over="ignore", divide="ignore"):
        pairs = [(a, b, d - e) for d, a in rates for e, b in rates if d > e]
        least = last = max((b / a) ** (2.0 / more) for a, b, more in pairs)
        energy = least * SEARCHED[SEARCHED >= 1.0]
        for stop in system.stops:
            q = np.array([stop.clearance + stop.overlap_at(float(e)) for e in energy])
            rebound = np.sqrt(2.0 * energy / system.mass[stop.index]) / q
            reduced = q / np.sqrt(2.0 * flexibility[stop.index] * energy)
            for t, (degree, rate) in zip(system.damping_terms, rates[1:], strict=True):
                damping = rate * energy ** (0.5 * degree) * reduced ** dict(t.q).get(stop.mass, 0)
                last = max([last, *energy[1:][np.diff(damping > rebound)]])
    if not LEVEL * last < MAX_ENERGY:  # terms too weak for any motion in double precision
        return None
    state = _escaping_state(system, unit, LEVEL * float(last), LEVEL * float(last) / float(least))
    return None if state is None else _escape_reason(system, state)


def _escaping_state(system: System, unit: Array, energy: float, span: float) -> Array | None:
    """Return a state (q, v), (2n,), of a motion that escapes from ``energy``; None if all return.

    It is the last state of the motion below ``ESCAPED · energy``. Implicit Euler steps with one
    correction damp vibrations that do not grow; steps are short where the linearised motion grows.
    A motion has returned when it has lost half of its energy, and has escaped when it leaves the
    range of double precision or still rises at the end. ``unit`` (2n,) scales (q, v);
    ``energy/span`` is the lowest energy at which two rates are equal.
    """
    n, rates, rng = system.n, _motion(system, unit), np.random.default_rng(0)
    # In two thirds of the states about half of the coordinates are small, log-uniformly down to a
    # tenth of their size at ``energy/span``.
    small = rng.random((DRAWN, 2 * n)) < 0.5
    small[::3] = False
    share = np.where(small, (10.0 * np.sqrt(span)) ** -rng.random((DRAWN, 2 * n)), 1.0)
    z = rng.normal(size=(DRAWN, 2 * n)) * share
    z = np.asarray(z / np.linalg.norm(z, axis=1)[:, None] * np.sqrt(2.0 * energy) * unit)
    q, momentum = z[:, :n], z[:, n:] * system.mass
    with np.errstate(over="ignore"):
        while (above := system.hamiltonian(q, momentum) > 2.0 * energy).any():
            q[above] *= 0.9  # springs and stops take no more energy than that
    power = _term_powers(system, z)
    feeding = np.sum(power, axis=0) < -ROUND_OFF * np.sum(np.abs(power), axis=0)
    x = far = (z / unit)[feeding][: max(8, min(FOLLOWED, 128 // n))]
    masses = sorted({m - 1 for t in system.damping_terms for m in t.masses.values()})
    driven = np.array([*masses, *(n + m for m in masses)])
    alike = np.kron(np.eye(2), np.ones((n, n)))
    quiet = np.errstate(over="ignore", invalid="ignore", divide="ignore")
    with quiet, threadpool_limits(limits=1, user_api="blas"):  # its matrices are small
        _, J, begun = rates(x)
        highest, halfway, dt = begun, begun, CHANGE / np.abs(J).sum(axis=(1, 2))
        for step in range(STEPS):
            f, J, now = rates(x)
            highest = np.maximum(highest, now)
            halfway = highest if 2 * step <= STEPS else halfway
            far = np.where((now < ESCAPED * energy)[:, None], x, far)
            if not ((now < MAX_ENERGY) & np.isfinite(J).all(axis=(1, 2))).all():
                break
            out = now > 0.5 * begun
            if not out.any():
                return None
            x, f, J, now, dt = x[out], f[out], J[out], now[out], dt[out]
            far, begun, highest, halfway = far[out], begun[out], highest[out], halfway[out]
            eigenvalues = np.linalg.eigvals(J[:, driven[:, None], driven])
            growth, modulus = eigenvalues.real, np.abs(eigenvalues)
            largest = modulus.max(axis=1, keepdims=True)
            grows = growth > np.maximum(SLOW * modulus, ROUND_OFF * largest)
            longest = np.where(grows, MOVED * growth / modulus**2, np.inf)
            dt = np.minimum(dt, longest.min(axis=1))
            inverse = np.linalg.inv(np.eye(2 * n) - dt[:, None, None] * J)
            first = np.einsum("sij,sj->si", inverse, dt[:, None] * f)
            second = np.einsum("sij,sj->si", inverse, dt[:, None] * rates(x + first)[0] - first)
            # A displacement (velocity) below 1e-3 of the norm of all of them may change by more.
            scale = np.abs(x) + np.abs(x + first) + 1e-3 * np.sqrt(x**2 @ alike)
            moved = np.linalg.norm(first, axis=1) / np.linalg.norm(x, axis=1)
            change = np.maximum(np.max(np.abs(second) / scale, axis=1), CHANGE / MOVED * moved)
            x = np.where((change <= CHANGE)[:, None], x + first + second, x)
            factor = 0.8 * np.sqrt(CHANGE / np.maximum(change, ROUND_OFF))
            dt = dt * np.where(np.isfinite(change), np.clip(factor, 0.2, 2.0), 0.1)
        else:
            now = np.where(highest > ESCAPED * halfway, now, 0.0)
        gone = ~(now <= ESCAPED * energy)
    return far[np.argmax(gone)] * unit if gone.any() else None


def _motion(system: System, unit: Array) -> Callable[[Array], tuple[Array, Array, Array]]:
    """Return the function from states x = (q, v)/``unit`` (states, 2n) to dx/dt without noise
    (states, 2n), ∂(dx/dt)/∂x (states, 2n, 2n) and H (states,)."""
    n, terms, K = system.n, system.damping_terms, system.stiffness_matrix
    powers = np.array([[*t.powers("q", n), *t.powers("v", n)] for t in terms])
    powers[range(len(terms)), [n + t.column for t in terms]] += 1
    energy, strength = np.array([t.energy for t in terms]), np.zeros((len(terms), n))
    for k, t in enumerate(terms):
        strength[k, t.row] = -t.coefficient / system.mass[t.row]
    linear = np.zeros((2 * n, 2 * n))
    linear[:n, n:] = np.eye(n)
    linear[n:] = -np.hstack([K, system.damping]) / system.mass[:, None]

    def rates(x: Array) -> tuple[Array, Array, Array]:
        z = x * unit
        q, momentum = z[:, :n], z[:, n:] * system.mass
        f, J = z @ linear.T, np.repeat(linear[None], len(z), axis=0)
        H, slope = system.hamiltonian(q, momentum), np.hstack([q @ K, momentum])
        for stop in system.stops:
            i, overlap = stop.index, np.maximum(stop.sign * q[:, stop.index] - stop.clearance, 0.0)
            force = stop.sign * stop.force(overlap)
            slope[:, i] += force
            f[:, n + i] -= force / system.mass[i]
            J[:, n + i, i] -= np.where(overlap > 0.0, stop.slope(overlap), 0.0) / system.mass[i]
        monomials, level = np.prod(z[:, None] ** powers, axis=-1), H[:, None] ** energy
        f[:, n:] += (monomials * level) @ strength
        by_energy = monomials * energy * H[:, None] ** np.maximum(energy - 1, 0)
        J[:, n:] += (by_energy @ strength)[:, :, None] * slope[:, None]
        for k in range(2 * n):
            lower = np.maximum(powers - (np.arange(2 * n) == k), 0)
            by_one = powers[:, k] * np.prod(z[:, None] ** lower, axis=-1) * level
            J[:, n:, k] += by_one @ strength
        return f / unit, J * (unit / unit[:, None]), H

    return rates


def _term_powers(system: System, z: Array) -> Array:
    """Dissipated power c_ij v_i v_j (terms, states) of terms at ``z`` = (q, v) (states, 2n)."""
    q, v = z[:, : system.n], z[:, system.n :]
    H, terms = system.hamiltonian(q, v * system.mass), system.damping_terms
    return np.array([t.value(q, v, H) * v[:, t.row] * v[:, t.column] for t in terms])


def _escape_reason(system: System, state: Array) -> str:
    """Message with the term that feeds in most at ``state`` = (q, v), (2n,), and its region."""
    term = system.damping_terms[int(np.argmin(_term_powers(system, state[None])[:, 0]))]
    names = [f"{key}{i + 1}" for key in "qv" for i in range(system.n)]
    powers = [*term.powers("q", system.n), *term.powers("v", system.n)]
    factors = [f"{x}^{p}" if p > 1 else x for x, p in zip(names, powers, strict=True) if p]
    factors += [f"H^{term.energy}" if term.energy > 1 else "H"] if term.energy else []
    start = ", ".join(f"{x} = {value:.3g}" for x, value in zip(names, state, strict=True))
    side = ["<" if x < 0.0 else ">" for x in state]
    # A term of one factor in c_ii feeds energy in where it exceeds the constant damping.
    if term.i == term.j and term.energy == 0 and len(term.q + term.v) == 1:
        k, constant = int(np.argmax(powers)), max(float(system.damping[term.row, term.row]), 0.0)
        bound = (constant / abs(term.coefficient)) ** (1.0 / powers[k])
        signed = f"{names[k]} {side[k]} {bound if side[k] == '>' else 0.0 - bound:.3g}"
        where = f" for {signed}" if powers[k] % 2 else f" for |{names[k]}| > {bound:.3g}"
    else:
        odd = np.flatnonzero(np.mod([*powers[: system.n], *term.velocities(system.n)], 2))
        signs = [f"{names[k]} {side[k]} 0" for k in odd]
        where = f" where {' and '.join(signs)}" if signs else ""
    return (
        f"damping term {term.coefficient:g} {' '.join(factors)} of c_{term.i}{term.j} feeds energy "
        f"in{where} without bound: the motion escapes, even without noise from {start}, and has no "
        "stationary density"
    )
