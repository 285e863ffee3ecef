"""Random systems of one or two masses with stops, of which every density is known exactly."""

import numpy as np
from sim_gibbs import Gibbs

from fpk.answer.contacts import contact_quantities
from fpk.answer.dynamics import upcrossings
from fpk.answer.names import parse_observable
from fpk.system.contact import Contact
from fpk.system.system import System
from sim.montecarlo import MonteCarlo

Array = np.ndarray

AROUND = np.array([-0.3, -0.1, -0.03, -0.01, -1e-3, 0.0, 1e-3, 0.01, 0.03, 0.1, 0.3])
"""Distances of the points from a kink, in units of its own scale."""
EXPONENTS = {"hertz": 1.5, "bilinear": 1.0}


def random_stops(seed: int) -> tuple[Gibbs, System]:
    """Return a system and its exact densities: one or two masses, stops on one of them.

    Stiffness of the stops 1e-2 to 1e8 of the spring's at the rms displacement without them,
    clearance 0 to 3 of these rms, all laws, on one side or both.
    """
    stream = np.random.default_rng([20261126, seed])
    n = 1 + seed % 2
    mass, stiffness = (tuple(10.0 ** stream.uniform(*x, n)) for x in ((-0.5, 0.5), (-0.7, 0.7)))
    contact, kT = int(stream.integers(n)), 10.0 ** stream.uniform(-1.0, 1.0)
    spring = Gibbs(mass, stiffness, kT, contact, ()).spring
    rms = np.sqrt(kT / spring)
    law = str(stream.choice(["hertz", "bilinear", "power"]))
    exponent = EXPONENTS.get(law, float(stream.choice([1.2, 2.0, 2.5, 3.0])))
    both, alike = stream.random() < 0.5, stream.random() < 0.7

    def stop(sign: float) -> tuple[float, float, float, float]:
        gap = stream.choice([0.0, stream.uniform(0.0, 0.3), stream.uniform(0.0, 3.0)])
        B = 10.0 ** stream.uniform(-2.0, 8.0) * spring * rms ** (1.0 - exponent)
        return sign, float(gap * rms), float(B), exponent

    stops = [stop(float(stream.choice([-1.0, 1.0])))]
    if both:
        sign, *rest = stops[0]
        stops.append((-sign, *rest) if alike else stop(-sign))
    own = {"exponent": exponent} if law == "power" else {}
    contacts = [
        Contact(contact + 1, "right" if sign > 0.0 else "left", B, gap, law=law, **own)
        for sign, gap, B, _ in stops
    ]
    damping = 2.0 * 10.0 ** stream.uniform(-1.5, -0.3) * np.sqrt(np.multiply(mass, stiffness))
    system = System(mass, stiffness, damping, kT * damping, contacts=tuple(contacts))
    return Gibbs(mass, stiffness, kT, contact, tuple(stops)), system


def points_at_kinks(exact: Gibbs) -> dict[str, tuple[Array, ...]]:
    """Return the points at which the densities are judged, eleven around each of their kinks."""
    i, kT, momentum = exact.contact + 1, exact.kT, np.sqrt(exact.mass[exact.contact] * exact.kT)
    rms = np.sqrt(kT / exact.spring)
    q = []
    for stop in exact.stops:
        scale = np.where(AROUND < 0.0, rms, min(6.0 * exact.depth(stop, kT), rms))
        q.append(stop[0] * (stop[1] + AROUND * scale))

    def energies(kinks: list[float]) -> Array:
        low = [e for e in kinks if e < 8.0 * kT] or [kT]
        x = np.concatenate([e + AROUND * kT for e in low])
        return x[x >= 0.0]

    p = momentum * np.array([0.0, 1.0, -0.3, 0.7, -2.0, 0.0, 1.5, 0.2, -0.8, 0.0, 0.5])
    return {
        f"q{i}": (np.concatenate(q),),
        f"p{i}": (momentum * np.linspace(-2.5, 2.5, 11),),
        "H": (energies(exact.touching()),),
        **{f"H{m + 1}": (energies(exact.touching_mode(m)),) for m in range(exact.n)},
        f"q{i},p{i}": (q[0], p),
    }


def exact_density(exact: Gibbs, name: str, *points: Array) -> Array:
    """Return the exact density of the observable ``name`` at points."""
    if "," in name:
        return exact.q(points[0]) * exact.p(points[1])
    if name == "H":
        return exact.H(points[0])
    if name[0] == "H":
        return exact.H_mode(int(name[1:]) - 1, points[0])
    return (exact.q if name[0] == "q" else exact.p)(points[0])


def deviations(exact: Gibbs, system: System, method: MonteCarlo) -> tuple[Array, Array, list[str]]:
    """Return z of all certified answers, L1 distance over what is stated, and refusals in words.

    Densities at ``points_at_kinks`` and every quantity at the stops.
    """
    names, z, ratios, refusals = points_at_kinks(exact), list[float](), list[float](), list[str]()
    asked = [parse_observable(name, system.n) for name in names]
    densities = dict(zip(names, method.solve(system, asked).densities, strict=True))
    for name, points in names.items():
        density = densities[name]
        if not density.certificate.certified:
            refusals += [f"{name}: {words}" for words in density.certificate.failures]
            continue
        value, error = density.at(*points)
        assert np.all(value >= -error)
        z += ((value - exact_density(exact, name, *points)) / error).tolist()
        if "," not in name:
            edges = density.edges[0][:: 4 if name[0] == "H" else 1]
            x, width = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
            value = density(x)
            seen = value > 1e-6 * value.max()
            off = np.abs(value - np.where(seen, exact_density(exact, name, x), value))
            ratios.append(float(off @ width) / density.l1_error)
    if refusals:
        return np.array(z), np.array(ratios), refusals
    of_q, pair = (densities[k] for k in names if k[0] == "q")
    for stop, known in zip(system.stops, exact.stops, strict=True):
        sign, gap, B, e = known
        assert (stop.sign, stop.clearance) == (sign, gap)
        found = contact_quantities(stop, of_q)

        def over(q: Array, sign: float = sign, gap: float = gap) -> Array:
            return np.maximum(sign * q - gap, 0.0)

        share, overlap, force = (
            exact.mean(f)
            for f in (
                lambda q: (over(q) > 0.0) + 0.0,
                over,
                lambda q, B=B, e=e: B * over(q) ** e,
            )
        )
        right = {"contact probability": share, "mean overlap": overlap, "mean force": force}
        right |= {"overlap in contact": overlap / share, "force in contact": force / share}
        z += [(found[k].value - x) / found[k].error for k, x in right.items()]
        at, mass = np.array([sign * gap]), float(system.mass[exact.contact])
        rate, error = upcrossings(pair, mass, at)
        z.append(float((rate[0] - exact.upcrossings(sign * gap)) / error[0]))
    return np.array(z), np.array(ratios), refusals
