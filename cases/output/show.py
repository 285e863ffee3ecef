"""The record and the text of ``fpk show``: system, effects, frequencies, theories, boundaries."""

from dataclasses import asdict
from typing import Any

from cases.comparison.regime import regime_of
from cases.comparison.routes import listed_methods
from cases.comparison.run import boundaries_of, incompatibility
from cases.output.records import effects_record, plain, regime_record, system_record
from cases.scene.scene import Scene
from fpk.effects import effects_of
from fpk.errors import NotApplicable
from fpk.method import Method
from fpk.observable import observable_name
from fpk.route import ROUTES, solvers_of


def show_record(scene: Scene) -> dict[str, Any]:
    """Return the record of ``fpk show``."""
    regime = regime_of(scene.system, incompatibility(scene.system))
    record = {
        "scene": scene.name,
        "title": scene.title,
        "source": scene.source,
        "system": system_record(scene.system),
        "observables": [observable_name(o) for o in scene.observables],
        "curves": [curve.label for curve in scene.curves],
        "effects": effects_record(effects_of(scene.system)),
        "natural_frequencies": regime.natural_frequencies,
        "regime": regime_record(regime),
        "theories": theories(scene),
        "boundaries": [asdict(b) for b in boundaries_of(scene.system)],
    }
    result: dict[str, Any] = plain(record)
    return result


def theories(scene: Scene) -> list[dict[str, Any]]:
    """Return for every METHOD whether it applies to the scene's own system, and why not."""
    records = []
    for name in listed_methods():
        routes = [ROUTES[name, solver] for solver in solvers_of(name)]
        by_solver = [_refusals(route.make(), scene) for route in routes]
        # An observable is refused where every solver refuses it: the default's reason is shown.
        refused = [column for column in zip(*by_solver, strict=True) if None not in column]
        records.append(
            {
                "method": name,
                "meaning": f"{routes[0].words}, Eq. {routes[0].equation}",
                "solvers": solvers_of(name),
                "applies": len(refused) < len(scene.observables),
                "reason": "; ".join(dict.fromkeys(str(column[0]) for column in refused)) or None,
            }
        )
    return records


def _refusals(method: Method, scene: Scene) -> list[str | None]:
    """Why the method does not give each observable of the scene, None where it does."""
    try:
        plan = method.prepare(scene.system)
    except NotApplicable as reason:
        return [str(reason)] * len(scene.observables)
    pairs = [(observable_name(o), plan.refusal(o)) for o in scene.observables]
    return [reason and reason.removeprefix(f"{name}: ") for name, reason in pairs]


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
