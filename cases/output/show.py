"""What a scene is before anything is solved: system, effects, frequencies, theories, boundaries."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from cases.comparison.regime import regime_of
from cases.comparison.routes import ROUTES, Request, method_for
from cases.comparison.run import boundaries_of, incompatibility
from cases.output.summary import effects_record, plain, system_record
from cases.scene.scene import Scene
from fpk.effects import effects_of
from fpk.method import Method
from fpk.observable import Observable, observable_name
from fpk.system import System

MEANING = {
    "exact": "exact solution of the full system, Eq. (7)",
    "linear": "Gaussian of a system without contact",
    "nonintegrable": "averaging of one energy, Eq. (11)",
    "integrable": "averaging of the modal energies, Eq. (34)",
    "montecarlo": "simulation of the full system, Eq. (6)",
}


def show_record(scene: Scene) -> dict[str, Any]:
    """Return the record of ``fpk show``."""
    methods = [method_for(Request(name)) for name, route in ROUTES.items() if route.make]
    regime = regime_of(scene.system, incompatibility(scene.system, methods))
    record = {
        "scene": scene.name,
        "title": scene.title,
        "source": scene.source,
        "system": system_record(scene.system),
        "observables": [observable_name(o) for o in scene.observables],
        "curves": [curve.label for curve in scene.curves],
        "effects": effects_record(effects_of(scene.system)),
        "natural_frequencies": regime.natural_frequencies,
        "regime": {**asdict(regime), "contacts_negligible": regime.contacts_negligible},
        "theories": theories(scene),
        "boundaries": [asdict(b) for b in boundaries_of(scene.system)],
    }
    result: dict[str, Any] = plain(record)
    return result


def theories(scene: Scene) -> list[dict[str, Any]]:
    """Return for every METHOD whether it applies to the scene's own system, and why not."""
    found = []
    for name, route in ROUTES.items():
        methods = [method_for(Request(name, solver)) for solver in (route.solvers or (None,))]
        reasons = [_refused(methods, scene.system, o) for o in scene.observables]
        refused = list(dict.fromkeys(r for r in reasons if r is not None))
        found.append(
            {
                "method": name,
                "meaning": MEANING[name],
                "solvers": route.solvers,
                "applies": None in reasons,
                "reason": "; ".join(refused) or None,
            }
        )
    return found


def _refused(methods: Sequence[Method], system: System, observable: Observable) -> str | None:
    """Why none of a theory's solvers gives ``observable``: the first one's reason, or None."""
    reasons = [method.refusal(system, observable) for method in methods]
    if None in reasons:
        return None
    return str(reasons[0]).removeprefix(f"{observable_name(observable)}: ")


def show_text(record: dict[str, Any]) -> str:
    """Return the record of ``show_record`` for reading."""
    system, effects = record["system"], record["effects"]
    lines = [record["title"], record["source"], "", "System, Eq. (1)"]
    lines += [f"  {key:16} {_short(system[key])}" for key in ("mass", "stiffness")]
    lines += [f"  {key:16} {_diagonal(system[key])}" for key in ("damping", "noise_intensity")]
    lines += [
        f"  contact {i:<8} mass {c['mass']}, {c['side']}, {c['law']} ({c['exponent']:g}),"
        f" B = {c['stiffness']:g}, δ = {c['clearance']:g}"
        for i, c in enumerate(system["contacts"], start=1)
    ] or ["  no contact"]
    lines += [
        f"  damping term {i:<3} {term_text(t)}" for i, t in enumerate(system["damping_terms"], 1)
    ]
    words = [f"{key} {_short(value)}" for key, value in effects.items()]
    lines += ["", "Effects", *(f"  {w}" for w in words)]
    lines += ["", "Natural frequencies", f"  {_short(record['natural_frequencies'])}"]
    lines += ["", "Clearance against motion (section 6.3: negligible beyond 2 rms)"]
    lines += [
        f"  mass {s['mass']} {s['side']:5} clearance {s['clearance']:g}"
        + (f" = {s['ratio']:.3g} rms without contact" if s["ratio"] is not None else "")
        for s in record["regime"]["stops"]
    ] or ["  no contact"]
    lines += ["", "Theories"]
    for t in record["theories"]:
        lines.append(
            f"  {t['method']:14} {'applies' if t['applies'] else 'does not apply'}: {t['meaning']}"
        )
        if t["reason"]:
            lines.append(f"  {'':14} {t['reason']}")
    lines += ["", "Boundaries of the averaged energies"]
    lines += [
        f"  {b['process']:14} {b['end']}: {b['kind']} ({b['reason']})" for b in record["boundaries"]
    ] or ["  none"]
    return "\n".join(lines)


def term_text(term: dict[str, Any]) -> str:
    """The term as an equation: ``c11 += 0.05 q1^2 v2^2 H``."""
    factors = [
        name if power == 1 else f"{name}^{power}"
        for name, power in (
            *((f"{key}{mass}", power) for key in ("q", "v") for mass, power in term[key].items()),
            *([("H", term["energy"])] if term["energy"] else []),
        )
    ]
    return f"c{term['i']}{term['j']} += {' '.join([_short(term['coefficient']), *factors])}"


def _short(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(_short(v) for v in value) or "none"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _diagonal(matrix: list[list[float]]) -> str:
    off = [x for i, row in enumerate(matrix) for j, x in enumerate(row) if i != j]
    if any(off):
        return "; ".join(_short(row) for row in matrix)
    return _short([row[i] for i, row in enumerate(matrix)])
