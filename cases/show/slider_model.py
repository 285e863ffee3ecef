"""Parameters of the closed forms that the sliders of a report evaluate anew."""

from collections.abc import Iterable, Sequence
from itertools import repeat
from typing import Any

import numpy as np

from averaging.conditional import conditional
from averaging.modal.analysis import ModalAnalysis, modal_analysis
from averaging.modal.resonance import MAX_NEGLECTED
from cases.compare.answers import Answers
from cases.show.pictures.panel import Curve
from cases.show.pictures.style import SUBSCRIPTS
from cases.show.records import Record
from fpk.answer.names import Coordinate, Observable, observable_name
from fpk.numeric.arrays import Array
from fpk.system.system import System

MOST_MODES = 12
"""Largest number of modes for which the page computes the density of the sum of their energies."""


def slider_model(
    curve: Answers, observables: Sequence[Observable], units: Record | None = None
) -> tuple[Record | None, str]:
    """Return the parameters of Eqs. (29), (30), (34), (36), and a sentence on what is not computed.

    The parameters are None, and the sentence says why, unless energy averaging has answered, with
    constant damping, unmodulated noise, one contact mass and power laws, and one of ``observables``
    has a closed form. The sentence is empty if all is computed, and with None if neither energy
    nor modal averaging has answered. ``B`` and ``delta`` of each contact, ``c`` and ``D`` of each
    mass have names and values as run; a full matrix has one factor instead, of value 1. Rates are
    linear in c and D: α = Σ c rate / Σ D rate, and so are the modal damping and noise, whose
    neglected correlation is at most ``most``. ``of`` has the closed forms by observable.
    ``units`` is ``units_record``; it gives the ``unit`` of everything but a factor.
    """
    system = curve.system
    taken = {r.method.route.method for r in curve.results if r.method.route.solves == "averaged"}
    if not taken & {"nonintegrable", "integrable"}:
        return None, ""
    if why := _obstacle(system):
        return None, f"No sliders: the page has no closed form {why}."
    if "nonintegrable" not in taken:
        return None, "No sliders: energy averaging was not asked for, or does not apply."
    contact_mass = system.contact_masses[0]
    modes = system.fact(modal_analysis) if "integrable" in taken else None
    known = {
        observable_name(o): one
        for o in observables
        if len(o) == 1 and (one := _form(o[0], system, contact_mass, modes)) is not None
    }
    others = [o for o in map(observable_name, observables) if o not in known]
    missing = [f"for {' and '.join(others)}"] if others else []
    if modes is None:
        missing.append("of modal averaging, which gives no answer here")
    elif system.n > MOST_MODES and "H" in known:
        missing.append(f"for the sum of more than {MOST_MODES} modal energies")
    words = f"Sliders compute nothing {' and nothing '.join(missing)}." if missing else ""
    if not known:
        return None, words
    stops = [
        {"contact": k, "sign": s.sign, "B": s.stiffness, "delta": s.clearance, "e": s.power}
        for k, contact in enumerate(system.contacts)
        for s in contact.one_sided()
    ]
    gain = np.eye(system.n) if system.noise_gain is None else system.noise_gain
    shapes = np.zeros((system.n, 0)) if modes is None else modes.mode_shapes
    model: Record = {
        "n": system.n,
        "most": MAX_NEGLECTED,
        "frequency": [] if modes is None else modes.natural_frequency,
        "a": conditional(system, contact_mass, ()).precision,
        "stops": stops,
        "B": _contacts(system, "stiffness B", "stiffness"),
        "delta": _contacts(system, "clearance δ", "clearance"),
        "c": _linear("damping c", system.damping, np.eye(system.n), system, shapes),
        "D": _linear("noise D", system.noise_intensity, gain, system, shapes),
        "of": known,
    }
    if units is not None:
        own_units: dict[str, Iterable[str]] = {
            "B": units["contact_stiffness"],
            "delta": repeat(units["length"]),
            "c": repeat(units["damping"]),
            "D": repeat(units["noise_intensity"]),
        }
        for key, own in own_units.items():
            for one, unit in zip(model[key], own, strict=False):
                one["unit"] = "" if "matrix" in one else unit
    return model, words


def slider_curves(model: Record | None, observable: Observable) -> list[Curve]:
    """Return a curve without points for each closed form of ``observable`` in ``model``, if any."""
    forms = model["of"].get(observable_name(observable), {"forms": ()})["forms"] if model else ()
    own: Any = {"colour": "currentColor", "marker": "", "shown": False}
    drawn = {"energy": ("energy averaging", "--"), "modal": ("modal averaging", ":")}
    return [
        Curve(f"{name} by the sliders", (), (), style=style, form=form, **own)
        for form in forms
        for name, style in [drawn[form]]
    ]


def _obstacle(system: System) -> str:
    """Why the page cannot compute a closed form, in words; empty if it can."""
    if system.damping_terms:
        return "for damping that depends on the state"
    if system.modulation is not None:
        return "for modulated noise"
    if len(system.contact_masses) != 1:
        return "unless one mass has contacts"
    x = np.array([0.3, 1.7])
    for stop in system.stops:
        expected = stop.stiffness * x ** (stop.power + 1.0) / (stop.power + 1.0)
        if not np.allclose(stop.energy(x), expected, rtol=1e-12):
            return "for this law of contact"
    return ""


def _contacts(system: System, words: str, key: str) -> list[Record]:
    several = len(system.contacts) > 1
    return [
        {"name": f"{words} of contact {k}" if several else words, "value": getattr(contact, key)}
        for k, contact in enumerate(system.contacts, start=1)
    ]


def _linear(
    words: str, intensity: Array, gain: Array, system: System, shapes: Array
) -> list[Record]:
    """The entries of a diagonal ``intensity`` I (n, n), or one factor of a full matrix.

    ``gain`` is g (n, n), ``shapes`` T (n, modes); ``words`` begin each name. Per unit of its value
    an entry adds ``rate`` to Σ (g I gᵀ)_ii/m_i, and ``matrix``, or v vᵀ with ``vector`` v, to
    Tᵀ g I gᵀ T.
    """
    diagonal = np.diag(intensity)
    if not np.array_equal(intensity, np.diag(diagonal)):
        matrix = gain @ intensity @ gain.T
        one = {
            "name": f"all {words}, as a factor",
            "value": 1.0,
            "matrix": shapes.T @ matrix @ shapes,
        }
        return [{**one, "rate": float(np.sum(np.diag(matrix) / system.mass))}]
    return [
        {
            "name": f"{words}{str(k + 1).translate(SUBSCRIPTS)}",
            "value": value,
            "rate": float(np.sum(gain[:, k] ** 2 / system.mass)),
            "vector": shapes.T @ gain[:, k],
        }
        for k, value in enumerate(diagonal)
    ]


def _form(
    c: Coordinate, system: System, contact_mass: int, modes: ModalAnalysis | None
) -> Record | None:
    """Parameters of the closed forms of ``c``, named in ``forms``; None if there are none."""
    modal = [] if modes is None else ["modal"]
    if c.kind == "H":
        if c.index is not None:
            return {"kind": "Hi", "mode": c.row, "forms": modal} if modal else None
        return {"kind": "H", "forms": ["energy", *modal[: system.n <= MOST_MODES]]}
    one: Record = {"kind": c.kind, "mass": system.mass[c.row], "forms": ["energy", *modal]}
    if modes is not None:  # (20), (35): of independent ω Q_i and P_i of variance θ_i
        row = c.row + (system.n if c.kind == "p" else 0)
        half = modes.state_shapes[row].reshape(2, system.n)
        one["weights"] = np.sum(half**2, axis=0)
    if c.kind == "q" and c.row != contact_mass:
        law = conditional(system, c.row, (contact_mass,))
        one["beside"] = {"w": law.weights[0], "precision": law.precision}
    return one
