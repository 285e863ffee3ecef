"""Random chains, drawn once a seed: no certified answer outside its stated error, on any route."""

import ast
import warnings
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pytest
import references
from references import Chain, EnergyReference, LinearReference, ModalReference, Stop, Term

from averaging.gaussian import Linear
from averaging.integrable import Integrable
from averaging.nonintegrable import NonIntegrable
from averaging.phase_space.method import PhaseSpace
from averaging.theory import Exact
from fpk.answer.method import ROUTES
from fpk.answer.names import observable_name, parse_observable
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.numeric.quadrature import panel_rule
from fpk.system.contact import Contact
from fpk.system.damping import DampingTerm
from fpk.system.system import System

TOL = 1e-8
"""The L1 tolerance that is asked of every method."""
L1_SLACK = 1.05
"""∫|error| is taken from a rule on points: so much of it may come from there."""
LAWS = {"hertz": 1.5, "bilinear": 1.0}
OF_METHOD = {
    Exact: EnergyReference,
    NonIntegrable: EnergyReference,
    Linear: LinearReference,
    Integrable: ModalReference,
}


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
        rms = np.sqrt(theta * chain.compliance(-1, i))
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
    unit = {"H": 1.0, "q": 1.0 / chain.compliance(-1, a), "v": chain.mass[a]}[kind]
    return (Term(i, float(strength * unit), kind, a),)


def system_of(chain):
    """The product's record of the chain."""
    contacts = []
    for s in chain.stops:
        side = "right" if s.sign > 0 else "left"
        numbers = s.stiffness, s.clearance, "power", s.exponent
        contacts.append(Contact(s.index + 1, side, *numbers))
    terms = []
    for t in chain.terms:
        powers = {"H": {"energy": 1}}.get(t.kind) or {t.kind: ((t.a + 1, 2),)}
        terms.append(DampingTerm(t.i + 1, t.i + 1, t.coefficient, **powers))
    numbers = chain.mass, chain.stiffness, chain.damping, chain.noise
    return System(*numbers, contacts=tuple(contacts), damping_terms=tuple(terms))


@dataclass(frozen=True)
class Answer:
    """One density beside its reference: errors at the points in units of those stated."""

    name: str  # route and observable, or why there is no density
    certified: bool = False
    stated: float = np.inf  # the stated L1 error
    ratio: float = 0.0  # largest error at a point over the stated error
    l1_ratio: float = 0.0  # true over stated L1 error, 0 where not evaluated
    referenced: bool = False
    where: str = ""

    @property
    def lie(self) -> str:
        """Why the certificate is wrong, empty where it is not."""
        if not self.certified:
            return ""
        if not self.stated <= TOL:
            return f"certified with the stated error {self.stated:.2g} above the tolerance {TOL:g}"
        if not self.ratio <= 1.0:
            return f"off by {self.ratio:.3g} times the stated error: {self.where}"
        if not self.l1_ratio <= L1_SLACK:
            return f"off by {self.l1_ratio:.3g} times the stated L1 error {self.stated:.2g}"
        return ""


class Attack:
    """One chain, its system and the references of its routes, each evaluated once."""

    def __init__(self, seed, chain=None):
        self.seed, self.chain = seed, drawn(seed) if chain is None else chain
        self.system = system_of(self.chain)
        self.references = {kind: kind(self.chain) for kind in set(OF_METHOD.values())}
        self.evaluated = {}

    def reference(self, method, coordinate, x):
        """p and its error at x, or None where there is no reference."""
        reference = self.references[OF_METHOD[type(method)]]
        key = type(reference), coordinate, x.tobytes()
        if key not in self.evaluated:
            kinds = {"H": "of_energy", "q": "of_displacement", "p": "of_momentum"}
            of, row = kinds[coordinate.kind], coordinate.index
            if coordinate.kind == "H" and row is not None:
                of = "of_modal_energy"
            self.evaluated[key] = getattr(reference, of)(*([] if row is None else [row]), x)
        return self.evaluated[key]

    def points(self, c):
        """Points over the bulk and the tails, at stops, at energies of contact and close by."""
        rng, chain = np.random.default_rng(self.seed), self.chain
        theta = temperature(chain)
        if c.kind == "H":
            joints = [chain.contact_energy_of(s) for s in chain.stops]
            x = np.append(theta * 10.0 ** rng.uniform(-4, 0, 3), theta * rng.uniform(0, 12, 5))
            return np.append(x, [j * f for j in joints for f in (1 - 1e-6, 1.0, 1 + 1e-3)])
        of_q = c.kind == "q"
        rms = np.sqrt(theta * (chain.compliance(-1, c.index) if of_q else chain.mass[c.index]))
        x = np.append([0.0, 1e-7], rng.normal(size=8)) * 1.5 * rms
        stops = [s for s in chain.stops if of_q and s.index == c.index]
        return np.append(x, [s.sign * (s.clearance + d * rms) for s in stops for d in (0, 1e-3)])

    def answers(self, *, referenced=True):
        """Every answer of every deterministic route; ``referenced``: beside the references."""
        n = self.chain.n
        names = ["H", *(f"{kind}{i + 1}" for kind in ("q", "p", "H") for i in range(n))]
        observables = [parse_observable(name, n) for name in names]
        for key, route in ROUTES.items():
            method = route.make()
            if route.sampled or type(method) not in OF_METHOD:
                continue
            if "tol" in {f.name for f in fields(method)}:
                method = replace(method, tol=TOL)
            try:
                plan = method.prepare(self.system)
            except (NotApplicable, InvalidInput):
                continue
            given = [o for o in observables if plan.refusal(o) is None]
            if not given:
                continue
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    result = method.solve(self.system, given)
            except (NotApplicable, NotCertified) as reason:
                yield Answer(f"{self.seed} {'/'.join(key)}: {reason}")
                continue
            for observable, density in zip(given, result.densities, strict=True):
                name = f"{self.seed} {'/'.join(key)} {observable_name(observable)}"
                made = Answer(name, density.certificate.certified, density.l1_error)
                judged = referenced and made.certified
                yield self.judged(made, method, *observable, density) if judged else made

    def judged(self, made, method, coordinate, density):
        """The answer with its errors against the reference, if there is one."""
        (nodes,) = density.panels
        x = np.unique(self.points(coordinate))
        x = x[(x > nodes[0]) & (x < nodes[-1])]
        if (truth := self.reference(method, coordinate, x)) is None:
            return made
        p, stated = density.at(x)
        # The reference has an error, too; what is below a millionth of the smallest normal is 0.
        ratio = np.maximum(np.abs(p - truth[0]) - truth[1], 0.0) / np.maximum(stated, 1e-300)
        worst = int(np.argmax(np.where(np.isnan(ratio), np.inf, ratio)))
        where = (
            f"at {x[worst]:.10g} it says {p[worst]:.12g} ± {stated[worst]:.2g}, the reference "
            f"{truth[0][worst]:.12g} ± {truth[1][worst]:.2g}"
        )
        made = replace(made, ratio=float(ratio[worst]), referenced=True, where=where)
        if coordinate == ("H", None) and OF_METHOD[type(method)] is not EnergyReference:
            return made  # a contour integral of forty digits a point
        # ∫|p − p_ref| over the support from three points a panel.
        if nodes.size > 41:
            nodes = np.unique(np.append(nodes[:: nodes.size // 40], nodes[-1]))
        x, w = (part.ravel() for part in panel_rule(nodes, 3))
        truth, error = self.reference(method, coordinate, x)
        off = float(w @ np.maximum(np.abs(density.at(x)[0] - truth) - error, 0.0))
        return replace(made, l1_ratio=off / density.l1_error if density.l1_error > 0 else np.inf)


FAST = (16, 22, 24, 44)
"""Seeds of the default tier."""
LEAST_CERTIFIED = 0.6


def assert_honest(seeds):
    answers = [answer for seed in seeds for answer in Attack(seed).answers()]
    lies = [f"{a.name}: {a.lie}" for a in answers if a.lie]
    assert not lies, "\n".join(lies)
    certified = sum(a.certified for a in answers)
    assert certified >= LEAST_CERTIFIED * len(answers)
    assert any(a.referenced for a in answers)


@pytest.mark.parametrize("seed", FAST)
def test_no_certified_answer_outside_its_stated_error(seed):
    assert_honest([seed])


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 200, 5))
def test_two_hundred_chains(first):
    assert_honest(range(first, first + 5))


@pytest.mark.parametrize("term", [Term(0, -0.01, "q"), Term(0, -0.03, "q"), Term(0, -0.02, "v")])
def test_densities_that_do_not_exist_are_not_certified(term):
    """The drift of an energy grows like +H²: no density is stationary, however far the tail."""
    chain = Chain(np.ones(2), np.ones(2), np.diag([0.1, 0.1]), np.diag([0.05, 0.05]), terms=(term,))
    for answer in Attack(0, chain).answers(referenced=False):
        assert not answer.certified, answer.name


def test_every_deterministic_route_has_a_reference():
    kinds = [type(route.make()) for route in ROUTES.values() if not route.sampled]
    own = [kind for kind in kinds if kind.__module__.partition(".")[0] in ("averaging", "cases")]
    # Judged by tests of its own, on systems whose full equation has a known solution.
    own.remove(PhaseSpace)
    assert own and set(own) <= OF_METHOD.keys()


def test_references_import_nothing_of_the_product():
    tree = ast.parse(Path(references.__file__).read_text(encoding="utf-8"))
    imports = [ast.unparse(x) for x in ast.walk(tree) if isinstance(x, ast.Import | ast.ImportFrom)]
    rooms = {line.split()[1].partition(".")[0] for line in imports}
    assert "numpy" in rooms and not rooms & {"fpk", "averaging", "sim", "cases"}
