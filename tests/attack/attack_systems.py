"""Random chains for the attack: drawn once a seed, as numbers and as systems of the product."""

import numpy as np
from attack_energy import Chain, Stop, Term

from fpk.system.contact import Contact
from fpk.system.damping import DampingTerm
from fpk.system.system import System

LAWS = {"hertz": 1.5, "bilinear": 1.0}


def decades(rng, low, high, size=None):
    return 10.0 ** rng.uniform(low, high, size)


def drawn(seed):
    """A chain of one to four masses whose springs differ by up to 1e6, and what it is like."""
    rng = np.random.default_rng([20261122, seed])
    n = int(rng.integers(1, 5))
    mass = decades(rng, -1, 1, n)
    span = rng.choice([0.0, 1.0, 3.0])
    stiffness = decades(rng, -span, span, n)
    noise = _matrix(rng, n, decades(rng, -2, 0))
    proportional = rng.random() < 0.35
    damping = (
        noise * decades(rng, -0.5, 1) if proportional else _matrix(rng, n, decades(rng, -2, 0))
    )
    chain = Chain(mass, stiffness, damping, noise)
    if rng.random() < 0.75:
        chain = chain._replace(stops=_stops(rng, chain))
    terms = rng.random() < 0.2
    if terms and len(chain.touching) <= 1:
        chain = chain._replace(terms=_terms(rng, chain, proportional))
    return chain


def _matrix(rng, n, size):
    """Positive definite matrix (n, n), diagonal three times in four, with entries over decades."""
    scale = size * decades(rng, -0.7, 0.7, n)
    if rng.random() < 0.75:
        return np.diag(scale)
    part = rng.normal(size=(n, n)) / n
    matrix = np.eye(n) + part @ part.T
    return np.sqrt(np.outer(scale, scale)) * 0.5 * (matrix + matrix.T)


def temperature(chain):
    return float(
        np.sum(np.diag(chain.noise) / chain.mass) / np.sum(np.diag(chain.damping) / chain.mass)
    )


def _stops(rng, chain):
    count = int(rng.integers(1, 3)) if chain.n > 1 else 1
    masses = rng.choice(chain.n, size=count, replace=False)
    theta, stops = temperature(chain), []
    for i in sorted(int(m) for m in masses):
        rms = np.sqrt(theta * np.sum(1.0 / chain.stiffness[: i + 1]))
        side = rng.choice(["left", "right", "both"])
        kind = rng.choice(["hertz", "bilinear", "power"])
        exponent = LAWS.get(str(kind), float(np.round(rng.uniform(1.0, 3.5), 2)))
        clearance = 0.0 if rng.random() < 0.2 else float(rms * rng.uniform(0.05, 3.0))
        # Contact energy at an overlap of one rms, in units of the temperature.
        size = float(decades(rng, -1, 5) * theta * (exponent + 1.0) / rms ** (exponent + 1.0))
        signs = {"left": (-1.0,), "right": (1.0,), "both": (-1.0, 1.0)}[str(side)]
        stops += [Stop(i, sign, size, clearance, exponent) for sign in signs]
    return tuple(stops)


def _terms(rng, chain, proportional):
    """Terms that only ever take energy out; H·D in proportion to the noise where the damping is."""
    theta = temperature(chain)
    strength = decades(rng, -1.5, 0.5) * float(np.trace(chain.damping)) / chain.n / theta
    kind = str(rng.choice(["H", "q", "v"]))
    diagonal = not np.any(chain.noise - np.diag(np.diag(chain.noise)))
    if kind == "H" and proportional and diagonal:
        share = strength * chain.n / float(np.trace(chain.noise))
        return tuple(Term(i, share * float(chain.noise[i, i]), "H") for i in range(chain.n))
    i, a = int(rng.integers(chain.n)), int(rng.integers(chain.n))
    unit = {"H": 1.0, "q": 1.0 / np.sum(1.0 / chain.stiffness[: a + 1]), "v": chain.mass[a]}[kind]
    return (Term(i, float(strength * unit), kind, a),)


def system_of(chain):
    """The product's record of the chain."""
    contacts = tuple(
        Contact(
            mass=s.index + 1,
            side="right" if s.sign > 0 else "left",
            stiffness=s.stiffness,
            clearance=s.clearance,
            law="power",
            exponent=s.exponent,
        )
        for s in chain.stops
    )
    terms = tuple(
        DampingTerm(
            t.i + 1,
            t.i + 1,
            t.coefficient,
            q=((t.a + 1, 2),) if t.kind == "q" else (),
            v=((t.a + 1, 2),) if t.kind == "v" else (),
            energy=1 if t.kind == "H" else 0,
        )
        for t in chain.terms
    )
    return System(
        chain.mass,
        chain.stiffness,
        chain.damping,
        chain.noise,
        contacts=contacts,
        damping_terms=terms,
    )
