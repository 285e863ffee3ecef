"""Systems, effects, certificates and densities as plain records: what JSON has of them."""

import hashlib
import json
from contextlib import suppress
from dataclasses import asdict, fields, is_dataclass
from importlib.metadata import PackageNotFoundError, version
from math import isfinite
from typing import Any

import numpy as np

from averaging.energy_process import energy_process
from averaging.modal.analysis import modal_analysis
from cases.comparison.run import incompatibility
from fpk.clearance import stop_clearances
from fpk.damping import DampingTerm
from fpk.density import AnyDensity
from fpk.effects import effects_of
from fpk.ends import BoundaryClass, classify
from fpk.errors import NotApplicable
from fpk.linear import natural_frequencies
from fpk.system import System

UNITS = "the scene's own consistent units"

MODES_SHOWN = 4
"""Modes whose boundaries are shown; with constant damping they are alike in all."""


def program_version() -> str:
    """Return the version of the installed distribution."""
    try:
        return version("vibro-fpk")
    except PackageNotFoundError:
        return "(not installed)"


def plain(value: Any) -> Any:
    """Return ``value`` as JSON has it: lists and numbers; what is not finite becomes null.

    A record becomes the dictionary of its fields.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float) and not isfinite(value):
        return None
    return value


def hash_of(record: dict[str, Any]) -> str:
    """Return a short hash of everything in ``record``."""
    text = json.dumps(plain(record), sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def certificate_record(density: AnyDensity) -> dict[str, Any]:
    """Return the certificate with whether it holds."""
    certificate = density.certificate
    return {**asdict(certificate), "certified": certificate.certified}


def facts_record(system: System) -> dict[str, Any]:
    """Return the system, its effects, and its regime: what decides between the theories.

    Masses count from 1. ``incompatible`` says why the compatibility condition (8) fails, None where
    it holds.
    """
    effects, stops = effects_of(system), system.fact(stop_clearances)
    beyond = [stop.beyond_rule for stop in stops]
    masses = [i + 1 for i in effects.contact_masses]
    return {
        "system": system_record(system),
        "effects": {**asdict(effects), "contact_masses": masses, "contact": effects.contact},
        "regime": {
            "natural_frequencies": natural_frequencies(system),
            "incompatible": incompatibility(system),
            "stops": [{**asdict(s), "beyond_rule": s.beyond_rule} for s in stops],
            "contacts_negligible": None if None in beyond else all(beyond),
            "boundaries": _boundaries(system),
        },
    }


def _boundaries(system: System) -> list[dict[str, Any]]:
    """The ends of the averaged energies (24) and (17), of each theory that applies."""
    ends: list[tuple[str, BoundaryClass]] = []
    with suppress(NotApplicable):
        ends += [("nonintegrable", end) for end in classify(energy_process(system))]
    with suppress(NotApplicable):
        process = system.fact(modal_analysis).process()
        for axis in range(min(process.dimension, MODES_SHOWN)):
            ends += [("integrable", end) for end in classify(process, axis)]
    return [{"process": theory, **asdict(end)} for theory, end in ends]


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
