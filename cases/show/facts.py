"""Facts of a system as plain records: its effects, regime, modes, rms, and applicable theories."""

from contextlib import suppress

import numpy as np

from averaging.energy_process import energy_process
from averaging.modal.analysis import modal_analysis
from cases.compare.doubt import averaging_notes, incompatibility
from cases.compare.routes import all_routes, method_for
from cases.scene.numbers import Place, has_unit_gain
from cases.scene.scene import Scene
from cases.scene.units import NUMBER
from cases.show.records import Record, plain
from fpk.answer.contacts import stop_clearances
from fpk.answer.method import ROUTES, Progress, Route, solvers_of
from fpk.answer.names import Coordinate, observable_name
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.system.ends import BoundaryClass, classify
from fpk.system.escape import escape
from fpk.system.linear import natural_modes
from fpk.system.system import System, effects_of
from sim.montecarlo import MonteCarlo
from sim.sample.settings import estimate_seconds

MODES_SHOWN = 50
"""Largest number of modes whose damping, shape and boundaries are given: time grows as n³."""
MASSES, LINEAR_MASSES = 3, 50
"""Largest numbers of masses, with one contact mass and without contacts, for which the rms of every
displacement is computed, in about a second. Otherwise, and for damping that depends on the state
beside a contact, only the rms of the contact mass, if there is one."""
RMS_METHODS = ("linear", "exact", "nonintegrable")
"""Methods tried in this order for the rms of a displacement; the first two are exact for (6)."""


def show_record(scene: Scene) -> Record:
    """Return ``fpk show`` as plain values: system, modes, rms, units, and ``theories``."""
    facts, rms = facts_record(scene.system), rms_record(scene.system)
    regime, routes = facts["regime"], {route.label: route for route in all_routes()}
    averaged = [("rms", [routes[row["route"]]], False) for row in rms[:1]]
    return plain(
        {
            "scene": scene.name,
            "title": scene.title,
            "source": scene.source,
            **facts,
            "observables": [observable_name(o) for o in scene.observables],
            "curves": [{k: getattr(c, k) for k in ("label", "key", "value")} for c in scene.curves],
            "units": units_record(scene),
            "natural_frequencies": regime["natural_frequencies"],
            "modes": modes_record(scene.system),
            "rms": rms,
            "averaging_notes": averaging_notes(scene.system, averaged),
            "theories": theories(scene),
            "boundaries": regime["boundaries"],
        }
    )


def units_record(scene: Scene) -> Record | None:
    """Return the units by quantity for JSON; None if the scene names no units.

    ``contact_stiffness`` lists the unit of B of each contact. The unit of the noise intensity D is
    empty if a noise gain is given: it depends on the dimension of the gain.
    """
    record = scene.units.record()
    if record is not None:
        if not has_unit_gain(scene.system):
            record["noise_intensity"] = ""
        places = [Place("contacts", "stiffness", (i,)) for i in range(len(scene.system.contacts))]
        powers = [place.powers(scene.system) or NUMBER for place in places]
        record["contact_stiffness"] = [scene.units.of(p) for p in powers]
    return record


def check_record(scene: Scene, progress: Progress | None = None) -> Record:
    """Return the record of ``fpk check``: sizes, theories, questions, estimated seconds of a run.

    ``applies`` has methods, ``refused`` and ``left_out`` records of ``theories``, for stationary
    densities; ``stationary_refusal`` says why the system has none, and is None if it has a
    stationary state. ``simulation_seconds`` is for all curves together, None if the simulation is
    refused, for the reason in ``simulation_refusal``. ``progress``: see ``theories``.
    """
    listed = theories(scene, progress)
    taken = [t["method"] for t in listed if t["applies"] and not t["left_out"]]
    seconds: float | None = 0.0
    refusal = None
    try:
        seconds = sum(estimate_seconds(MonteCarlo(), curve.system) for curve in scene.curves)
    except (NotApplicable, InvalidInput) as reason:
        seconds, refusal = None, str(reason)
    return plain(
        {
            "scene": scene.name,
            "valid": True,
            "masses": scene.system.n,
            "stops": len(scene.system.stops),
            "systems": len(scene.curves),
            "observables": [observable_name(o) for o in scene.observables],
            "applies": [t["method"] for t in listed if t["applies"]],
            "refused": [t for t in listed if not t["applies"]],
            "left_out": [t for t in listed if t["left_out"]],
            "stationary_refusal": MonteCarlo().refusal(scene.system, ()),
            "questions": [q.name for q in scene.passages] + [q.name for q in scene.transients],
            "simulation_seconds": seconds,
            "simulation_refusal": refusal,
            "phase_space": "phase-space" in taken,
        }
    )


def facts_record(system: System) -> Record:
    """Return the system, its effects, and its regime: the facts that decide between the theories.

    Masses count from 1. ``incompatible`` says why the compatibility condition (8) fails; None if it
    holds. ``contacts_negligible``: the rule of section 6.3 allows neglecting every contact, True
    without contacts; None if the motion without contacts is not stationary.
    """
    effects, stops = effects_of(system), system.fact(stop_clearances)
    beyond = [stop.beyond_rule for stop in stops]
    masses = [i + 1 for i in effects.contact_masses]
    given = ("mass", "stiffness", "damping", "noise_intensity", "noise_gain")
    return {
        "system": {
            **{key: getattr(system, key) for key in given},
            "contacts": system.contacts,
            "modulation": system.modulation and vars(system.modulation),
            "damping_terms": [
                {**plain(term), "q": dict(term.q), "v": dict(term.v)}
                for term in system.damping_terms
            ],
        },
        "effects": {**plain(effects), "contact_masses": masses, "contact": effects.stops > 0},
        "regime": {
            "natural_frequencies": natural_modes(system)[1],
            "incompatible": incompatibility(system),
            "stops": [{**plain(s), "beyond_rule": s.beyond_rule} for s in stops],
            "contacts_negligible": None if None in beyond else all(beyond),
            "boundaries": _boundaries(system),
        },
    }


def theories(scene: Scene, progress: Progress | None = None) -> list[Record]:
    """Return a record for every method: whether it applies to the scene's own system, and why not.

    A method applies if it gives one of the scene's observables by some solver; ``reason`` is about
    the observables that it does not give, None if there are none. ``left_out`` says why ``fpk run``
    leaves out a method that applies, else None. With ``progress`` ``Plan.attempt`` is asked, too.
    """
    records = []
    for name in dict.fromkeys(route.method for route in all_routes()):
        routes = [ROUTES[name, solver] for solver in solvers_of(name)]
        refusals = [_refusals(route, scene, progress) for route in routes]
        reasons: dict[str, list[str]] = {}
        for observable, *by_solver in zip(scene.observables, *refusals, strict=True):
            # Refused where every solver refuses it: the default's reason is shown.
            if None not in by_solver:
                of = observable_name(observable)
                reasons.setdefault(str(by_solver[0]).removeprefix(f"{of}: "), []).append(of)
        refused = sum(map(len, reasons.values()))
        applies, left_out = refused < len(scene.observables), None
        try:
            routes[0].make().unasked(scene.system)
        except NotApplicable as reason:
            left_out = str(reason) if applies else None
        records.append(
            {
                "method": name,
                "meaning": f"{routes[0].words}, Eq. {routes[0].equation}",
                "solvers": solvers_of(name),
                "applies": applies,
                "reason": "; ".join(
                    f"not for {', '.join(names)}: {reason}" if applies else reason
                    for reason, names in reasons.items()
                )
                or None,
                "left_out": left_out,
            }
        )
    return records


def _refusals(route: Route, scene: Scene, progress: Progress | None) -> list[str | None]:
    """Return why ``route`` does not give each of the scene's observables, None where it does."""
    try:
        plan = route.make().planned(scene.system, ())
    except NotApplicable as reason:
        return [str(reason)] * len(scene.observables)
    refused = list(map(plan.refusal, scene.observables))
    given = [o for o, reason in zip(scene.observables, refused, strict=True) if not reason]
    hopeless = plan.attempt(given, progress) if given and progress else None
    return [reason or hopeless for reason in refused]


def _boundaries(system: System) -> list[Record]:
    """The class of each end of the averaged energies, Eqs. (24) and (17), by theories that apply.

    ``process`` is the theory, beside the fields of ``BoundaryClass``. Empty if the motion escapes,
    which averaged energies do not show.
    """
    ends: list[tuple[str, BoundaryClass]] = []
    if system.fact(escape):
        return []
    with suppress(NotApplicable):
        ends += [("nonintegrable", end) for end in classify(energy_process(system))]
    with suppress(NotApplicable):
        process = system.fact(modal_analysis).process()
        for axis in range(min(process.dimension, MODES_SHOWN)):
            ends += [("integrable", end) for end in classify(process, axis)]
        if process.dimension > MODES_SHOWN:
            others = f"H{MODES_SHOWN + 1} to H{process.dimension}"
            reason = f"only the first {MODES_SHOWN} modes are"
            ends.append(("integrable", BoundaryClass(others, "not classified", reason)))
    return [{"process": theory, **plain(end)} for theory, end in ends]


def modes_record(system: System) -> list[Record]:
    """Return frequency ω_m, damping ratio and shape of the natural modes, the slowest first.

    The ratio is c*_mm/(2 ω_m), c* = Tᵀ c T with Tᵀ M T = 1, c the constant damping. ``coupled`` is
    the largest |c*_ml|/√(c*_mm c*_ll) over the other modes l, 0 without damping. The component of a
    shape that is largest in modulus is 1. Modes beyond ``MODES_SHOWN`` are left out.
    """
    shapes, omega = natural_modes(system)
    c = shapes.T @ system.damping @ shapes
    own = np.diag(c)
    with np.errstate(divide="ignore", invalid="ignore"):
        coupling = np.nan_to_num(np.abs(c) / np.sqrt(np.outer(own, own)), posinf=0.0)
    np.fill_diagonal(coupling, 0.0)
    largest = shapes[np.argmax(np.abs(shapes), axis=0), np.arange(system.n)]
    return [
        {
            "frequency": omega[m],
            "damping_ratio": own[m] / (2.0 * omega[m]),
            "coupled": np.max(coupling[m]),
            "shape": shapes[:, m] / largest[m],
        }
        for m in range(min(system.n, MODES_SHOWN))
    ]


def rms_record(system: System) -> list[Record]:
    """Return a row for each displacement (``of``): √E q_i² (``value``), its ``error``, ``route``.

    ``MASSES`` says for which masses; ``solves`` is "full" or "averaged". Empty for no mass, if no
    method of ``RMS_METHODS`` applies, or if more than one mass has stops: integrals that take
    seconds. The numerical errors may be large.
    """
    touching = system.contact_masses
    if len(touching) > 1:
        return []
    easy = not touching or not system.damping_terms
    every = easy and system.n <= (MASSES if touching else LINEAR_MASSES)
    wanted = [(Coordinate("q", i),) for i in (range(system.n) if every else touching)]
    for name in RMS_METHODS:
        with suppress(NotApplicable, NotCertified):
            method = method_for(name)
            result = method.solve(system, wanted)
            return [
                {
                    "of": density.name,
                    **vars(density.rms()),
                    "route": method.route.label,
                    "solves": method.route.solves,
                }
                for density in result.densities
            ]
    return []
