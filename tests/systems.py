"""Systems that tests of several rooms share, and the damping matrix of a state."""

from dataclasses import replace

import numpy as np

from fpk import Contact, DampingTerm, System

ONE_MASS = "[system]\nmass = [{}]\nstiffness = [{}]\ndamping = [{}]\nnoise_intensity = [{}]\n"
"""The text of a scene."""


def fig6(contacts=(), *, n=2, mass=None):
    """The chain of Fig. 6 for any n: c from 0.04 n down to 0.04, D from 0.01 up to 0.01 n."""
    count = np.arange(1.0, n + 1.0)
    mass = np.ones(n) if mass is None else mass
    return System(mass, np.ones(n), 0.04 * count[::-1], 0.01 * count, contacts=contacts)


def exact_system(contacts=(), *, mass=(1.0, 2.0), h=2.0):
    """Damping in proportion to the noise, c_i = h D_i: condition (8) holds."""
    D = np.array([0.1, 0.2])
    return System(mass, [1.0, 1.5], h * D, D, contacts=contacts)


def by_energy(rate, noise, contacts=(), *, mass=(1.0, 1.0, 1.0), stiffness=(1.0,) * 3, terms=()):
    """c = D Σ rate_e H^e: condition (8) holds, the density is exp(−∫ Σ rate_e H^e dH).

    ``noise`` is D, a matrix or its diagonal; ``terms`` are further damping terms.
    """
    D = np.diag(noise) if np.ndim(noise) == 1 else np.asarray(noise)
    n, (constant, *others) = len(D), rate
    own = tuple(
        DampingTerm(i + 1, j + 1, c * D[i, j], energy=e)
        for e, c in enumerate(others, start=1)
        for i, j in np.ndindex(D.shape)
    )
    numbers = mass[:n], stiffness[:n], constant * D, D
    return System(*numbers, contacts=contacts, damping_terms=(*own, *terms))


def chain(n, contacts=(), **more):
    """n unit masses and springs, D/c = ½ at each: the static stiffness at the last mass is 1/n."""
    ones = np.ones(n)
    return System(ones, ones, 0.1 * ones, 0.05 * ones, contacts=contacts, **more)


def both(stiffness, clearance=0.5, law="hertz", *, mass=2, exponent=None):
    return (Contact(mass, "both", stiffness, clearance, law, exponent),)


TWO_MASSES = (Contact(1, "both", 5.0, 0.3), Contact(2, "both", 10.0, 0.5))
SKEW = (Contact(1, "right", 3.0, 0.2, "bilinear"), Contact(2, "left", 20.0, 0.4))
TURNED = System([1, 2], [1, 1.5], [[0.08, 0.06], [-0.04, 0.05]], [0.01, 0.02])
"""Unequal temperatures and an antisymmetric part of the damping."""


def in_units(system, a, L, t):
    """The same system in other units: its numbers of mass, length and time times a, L and t."""
    E = a * L**2 / t**2
    terms = []
    for u in system.damping_terms:
        unit = L ** sum(p for _, p in u.q) * (L / t) ** sum(p for _, p in u.v) * E**u.energy
        terms.append(replace(u, coefficient=u.coefficient * a / t / unit))
    contacts = [
        replace(
            c, stiffness=c.stiffness * a * L ** (1.0 - c.power) / t**2, clearance=c.clearance * L
        )
        for c in system.contacts
    ]
    return System(
        a * system.mass,
        a / t**2 * system.stiffness,
        a / t * system.damping,
        a**2 * L**2 / t**3 * system.noise_intensity,
        system.noise_gain,
        contacts=tuple(contacts),
        damping_terms=tuple(terms),
    )


def mirrored(system):
    """The system that −q and −p obey: left and right are exchanged."""
    other = {"left": "right", "right": "left", "both": "both"}
    contacts = tuple(replace(c, side=other[c.side]) for c in system.contacts)
    terms = (
        replace(t, coefficient=t.coefficient * (-1.0) ** t.degree) for t in system.damping_terms
    )
    return replace(system, contacts=contacts, damping_terms=tuple(terms))


def damping_at(system, q, p):
    """Return c(q, p), (..., n, n), term by term, at displacements and momenta (..., n)."""
    c = np.broadcast_to(system.damping, (*q.shape[:-1], system.n, system.n)).copy()
    for term in system.damping_terms:
        c[..., term.row, term.column] += term.value(q, p / system.mass, system.hamiltonian(q, p))
    return c
