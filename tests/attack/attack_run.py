"""What the product answers on a drawn chain, beside the references.

``python tests/attack/attack_run.py [SEEDS]`` runs seeds (``0:200`` when left out) and lists every
answer that its own certificate does not cover.
"""

import sys
import warnings
from collections import Counter
from dataclasses import dataclass, fields, replace
from functools import cached_property
from time import perf_counter

import numpy as np
from attack_energy import EnergyReference
from attack_linear import LinearReference, ModalReference
from attack_systems import drawn, system_of, temperature

from averaging.gaussian import Linear
from averaging.integrable import Integrable
from averaging.nonintegrable import NonIntegrable
from averaging.theory import Exact
from fpk.answer.method import ROUTES
from fpk.answer.names import observable_name, parse_observable
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.numeric.quadrature import panel_rule

TOL = 1e-8
"""The L1 tolerance that is asked of every method."""
L1_SLACK = 1.05
"""∫|error| is taken from a rule on points: so much of it may come from there."""

OF_METHOD = {
    Exact: EnergyReference,
    NonIntegrable: EnergyReference,
    Linear: LinearReference,
    Integrable: ModalReference,
}


@dataclass(frozen=True)
class Answer:
    """One density beside its reference: errors at the points in units of those stated."""

    seed: int
    route: str
    observable: str
    certified: bool
    stated: float  # the stated L1 error
    ratio: float  # largest error at a point over the stated one, 0 without reference
    l1_ratio: float  # true over stated L1 error, 0 where not evaluated
    referenced: bool
    where: str = ""
    failures: tuple[str, ...] = ()

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
        self.seed = seed
        self.chain = drawn(seed) if chain is None else chain
        self.system = system_of(self.chain)
        self.references = {kind: kind(self.chain) for kind in set(OF_METHOD.values())}
        self.held = {}

    @cached_property
    def observables(self):
        n = self.chain.n
        names = ["H", *(f"{kind}{i + 1}" for kind in ("q", "p", "H") for i in range(n))]
        return [parse_observable(name, n) for name in names]

    def reference(self, method, observable, x):
        """p and its error at x, or None where there is no reference."""
        reference, (c,) = self.references[OF_METHOD[type(method)]], observable
        key = type(reference), observable_name(observable), x.tobytes()
        if key not in self.held:
            # Few at a time: integrals within integrals take 1e5 points for each of them.
            parts = [self._reference(reference, c, x[k : k + 8]) for k in range(0, x.size, 8)]
            value = (
                None if parts[0] is None else tuple(map(np.concatenate, zip(*parts, strict=True)))
            )
            self.held[key] = value
        return self.held[key]

    @staticmethod
    def _reference(reference, c, x):
        if c.kind == "H":
            return (
                reference.of_energy(x) if c.index is None else reference.of_modal_energy(c.index, x)
            )
        if c.kind == "q":
            return reference.of_displacement(c.index, x)
        return reference.of_momentum(c.index, x)

    def points(self, observable):
        """Points over the bulk and the tails, at stops, at energies of contact and close by."""
        rng = np.random.default_rng(self.seed)
        (c,), chain, theta = observable, self.chain, temperature(self.chain)
        if c.kind == "H":
            joints = [EnergyReference(chain).contact_energy_of(s) for s in chain.stops]
            x = np.append(theta * 10.0 ** rng.uniform(-4, 0, 3), theta * rng.uniform(0, 12, 5))
            x = np.append(x, [j * f for j in joints for f in (1 - 1e-6, 1.0, 1 + 1e-3)])
        else:
            wide = theta * (
                np.sum(1.0 / chain.stiffness[: c.index + 1])
                if c.kind == "q"
                else chain.mass[c.index]
            )
            x = np.append([0.0, 1e-7], rng.normal(size=8)) * 1.5 * np.sqrt(wide)
            if c.kind == "q":
                stops = [s for s in chain.stops if s.index == c.index]
                near = [
                    s.sign * (s.clearance + d * np.sqrt(wide)) for s in stops for d in (0, 1e-3)
                ]
                x = np.append(x, near)
        return np.unique(x)

    def answers(self, *, l1=True, routes=None, referenced=True):
        """Every answer of every deterministic route; ``referenced``: beside the references."""
        for key, route in ROUTES.items():
            if route.sampled or (routes and "/".join(key) not in routes):
                continue
            method = route.make()
            if type(method) not in OF_METHOD:
                continue
            if "tol" in {f.name for f in fields(method)}:
                method = replace(method, tol=TOL)
            try:
                plan = method.prepare(self.system)
            except (NotApplicable, InvalidInput):
                continue
            given = [o for o in self.observables if plan.refusal(o) is None]
            if not given:
                continue
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    result = method.solve(self.system, given)
            except (NotApplicable, NotCertified) as reason:
                yield Answer(self.seed, "/".join(key), "", False, np.inf, 0, 0, False, str(reason))
                continue
            for observable, density in zip(given, result.densities, strict=True):
                yield self.judged("/".join(key), method, observable, density, l1, referenced)

    def judged(self, route, method, observable, density, l1, referenced):
        name, certificate = observable_name(observable), density.certificate
        made = Answer(
            self.seed, route, name, certificate.certified, density.l1_error, 0, 0, False,
            failures=certificate.failures,
        )  # fmt: skip
        if not certificate.certified or not referenced:
            return made
        (nodes,) = density.panels
        x = self.points(observable)
        truth = self.reference(method, observable, x)
        if truth is None:
            return made
        inside = (x > nodes[0]) & (x < nodes[-1])
        x, truth = x[inside], [part[inside] for part in truth]
        p, stated = density.at(x)
        off = np.abs(p - truth[0])
        # The reference has an error, too; what is below a millionth of the smallest normal is 0.
        ratio = np.maximum(off - truth[1], 0.0) / np.maximum(stated, 1e-300)
        worst = int(np.argmax(np.where(np.isnan(ratio), np.inf, ratio)))
        where = (
            f"at {x[worst]:.10g} it says {p[worst]:.12g} ± {stated[worst]:.2g}, the reference "
            f"{truth[0][worst]:.12g} ± {truth[1][worst]:.2g}"
        )
        l1_ratio = self.l1_ratio(method, observable, density) if l1 else 0.0
        return replace(
            made, ratio=float(ratio[worst]), l1_ratio=l1_ratio, referenced=True, where=where
        )

    def l1_ratio(self, method, observable, density):
        """∫|p − p_ref| over the support in units of the stated error, from three points a panel."""
        (nodes,) = density.panels
        kind = OF_METHOD[type(method)]
        if kind is EnergyReference and len(self.chain.touching) > 1:
            return 0.0  # two masses integrated out at hundreds of points take minutes
        if kind is LinearReference and observable[0].kind == "H":
            return 0.0  # a contour integral of forty digits a point
        if nodes.size > 41:
            nodes = np.unique(np.append(nodes[:: nodes.size // 40], nodes[-1]))
        x, w = (part.ravel() for part in panel_rule(nodes, 3))
        truth, error = self.reference(method, observable, x)
        off = np.maximum(np.abs(density.at(x)[0] - truth) - error, 0.0)
        return float(w @ off) / density.l1_error if density.l1_error > 0 else np.inf


def main(arguments):
    first, last = (int(part) for part in (arguments or ["0:200"])[0].split(":"))
    routes = set(arguments[1:]) or None
    count, lies = Counter(), []
    for seed in range(first, last):
        start = perf_counter()
        attack = Attack(seed)
        chain = attack.chain
        spread = chain.stiffness.max() / chain.stiffness.min()
        print(f"{seed}: n = {chain.n}, k ratio {spread:.2g}, stops at "
              f"{[s.index + 1 for s in chain.stops]}, terms {[t.kind for t in chain.terms]}",
              flush=True)  # fmt: skip
        for answer in attack.answers(routes=routes):
            count["answers"] += 1
            count["certified"] += answer.certified
            count["referenced"] += answer.referenced
            count[f"certified {answer.route}"] += answer.certified
            count[f"answers {answer.route}"] += 1
            if answer.lie:
                lies.append(answer)
                print(f"  LIE {answer.route} {answer.observable}: {answer.lie}", flush=True)
            elif not answer.certified:
                print(
                    f"  --- {answer.route} {answer.observable}: {answer.failures or answer.where}"
                )
        print(f"  {perf_counter() - start:.1f} s", flush=True)
    for key, value in sorted(count.items()):
        print(f"{key}: {value}")
    print(f"{len(lies)} answers outside what their certificate says")
    return 1 if lies else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
