"""What ``--json`` prints: plain records with the keys of the contract."""

from dataclasses import asdict
from math import isfinite
from typing import Any

import numpy as np

from cases.comparison.compare import route_name
from cases.comparison.run import CurveOutcome, Outcome
from cases.output.telling import ErrorsApart, errors_apart
from cases.scene.scene import Scene
from fpk.damping import DampingTerm
from fpk.density import AnyDensity, Array, Density
from fpk.effects import Effects
from fpk.method import Method, Result
from fpk.system import System
from sim.report import Report


def run_record(outcome: Outcome) -> dict[str, Any]:
    """Return the record of ``fpk run``: the scene's own system, and beside it the other curves."""
    base, *others = outcome.curves
    record: dict[str, Any] = plain(
        {
            "scene": outcome.scene.name,
            **_curve_record(base),
            "curves": [{"label": c.label, **_curve_record(c)} for c in others],
            "problems": outcome.problems,
            "claims": [asdict(f) for f in outcome.findings],
            "seconds": outcome.seconds,
        }
    )
    return record


def _curve_record(curve: CurveOutcome) -> dict[str, Any]:
    return {
        "effects": effects_record(curve.effects),
        "regime": {
            **asdict(curve.regime),
            "contacts_negligible": curve.regime.contacts_negligible,
            "boundaries": [asdict(b) for b in curve.boundaries],
        },
        "methods": [_method_record(r) for r in curve.results]
        + [
            {
                "route": r.route,
                "applies": False,
                "failed": r.failed,
                "observables": r.observables,
                "reason": r.reason,
            }
            for r in curve.refusals
        ],
        "comparisons": [asdict(c) for c in curve.comparisons],
        "errors": [errors_record(e) for e in errors_apart(curve)],
        "identities": [
            {"method": route_name(r.method), **asdict(i), "z": i.z}
            for r in curve.results
            for i in r.identities
        ],
    }


def _method_record(result: Result) -> dict[str, Any]:
    return {
        "route": route_name(result.method),
        "method": result.method.name,
        "solver": result.method.solver,
        "applies": True,
        "seconds": result.seconds,
        "settings": dict(result.settings),
        "densities": [
            {
                "observable": d.name,
                "error_kind": d.error_kind,
                "l1_error": d.l1_error if isinstance(d, Density) else _sampling_error(result, d),
                "certificate": certificate_record(d),
            }
            for d in result.densities
        ],
    }


def _sampling_error(result: Result, density: AnyDensity) -> float | None:
    report = result.report
    return report.error_of(density.observable).sampling if isinstance(report, Report) else None


def errors_record(errors: ErrorsApart) -> dict[str, Any]:
    """Return the three errors of a sampled density; a step bias not measured is said to be so."""
    bias = errors.step_bias
    return {
        "route": errors.route,
        "observable": errors.observable,
        "sampling": errors.sampling,
        "step_bias": "not measured" if bias is None else {"L1": bias[0], "by_chance": bias[1]},
        "averaging": [
            {"theory": theory, "L1": distance, "error": error}
            for theory, distance, error in errors.averaging
        ],
    }


def certificate_record(density: AnyDensity) -> dict[str, Any]:
    """Return the certificate with whether it holds."""
    certificate = density.certificate
    return {**asdict(certificate), "certified": certificate.certified}


def density_record(
    scene: Scene, method: Method, result: Result, points: tuple[Array, ...]
) -> dict[str, Any]:
    """Return the record of ``fpk density`` at ``points``, one array per axis."""
    density = result.densities[0]
    values, errors = density.at(*points)
    listed = points[0] if len(points) == 1 else np.stack(points, axis=-1)
    record: dict[str, Any] = plain(
        {
            "scene": scene.name,
            "method": method.name,
            "solver": method.solver,
            "observable": density.name,
            "points": listed,
            "density": values,
            "error": errors,
            "error_kind": density.error_kind,
            "certificate": certificate_record(density),
            "settings": dict(result.settings),
            "seconds": result.seconds,
        }
    )
    return record


def effects_record(effects: Effects) -> dict[str, Any]:
    """Return the effects as users read them: masses counted from 1."""
    record = asdict(effects)
    record["contact_masses"] = [i + 1 for i in effects.contact_masses]
    return {**record, "contact": effects.contact}


def system_record(system: System) -> dict[str, Any]:
    """Return the system as it is computed with: full matrices, masses counted from 1."""
    record: dict[str, Any] = plain(
        {
            "mass": system.mass,
            "stiffness": system.stiffness,
            "damping": system.damping,
            "noise_intensity": system.noise_intensity,
            "noise_gain": system.noise_gain,
            "contacts": [asdict(c) for c in system.contacts],
            "damping_terms": [_term_record(term) for term in system.damping_terms],
        }
    )
    return record


def _term_record(term: DampingTerm) -> dict[str, Any]:
    powers = {key: {str(mass): power for mass, power in getattr(term, key)} for key in ("q", "v")}
    entry = {"i": term.i, "j": term.j, "coefficient": term.coefficient}
    return {**entry, **powers, "energy": term.energy}


def plain(value: Any) -> Any:
    """Return ``value`` as JSON has it: lists and numbers; what is not finite becomes null."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not isfinite(value):
        return None
    return value
