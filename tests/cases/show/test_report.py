"""The page of a run: its sentence, its tables, its colours, and what its policy allows."""

import re
from base64 import b64encode
from dataclasses import replace
from hashlib import sha256
from itertools import combinations

import numpy as np
import pytest

from cases.compare.attempts import Refusal
from cases.compare.compare import Comparison
from cases.compare.rare import SPLITTING
from cases.compare.routes import method_for, register_routes
from cases.compare.stationary import run_scene
from cases.scene.scene import load_scene
from cases.scene.units import Units
from cases.show.digest import comparison_rows, digest_of, refusal_record
from cases.show.page import TEMPLATES
from cases.show.pictures.chain import chain_svg
from cases.show.pictures.style import COLOURS, DARK, DASHES, MARKERS
from cases.show.report import headline_of, measure_of, numbers_of, report_html
from cases.show.text import (
    claims_counted,
    quantity_tables,
    refusals_of,
    render,
    theory_table,
)
from cases.show.words import CONSTANT_NOISE, reader_words
from fpk import Contact, System
from fpk.answer.method import ROUTES

register_routes()

XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
     [0.0193339, 0.1191920, 0.9503041]]
)  # fmt: skip
DEFICIENCIES = {
    "none": np.eye(3),
    # Machado, Oliveira, Fernandes 2009, severity 1, on linear RGB.
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
               [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
               [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
               [0.004733, 0.691367, 0.303900]],
}  # fmt: skip


def linear_rgb(colour):
    s = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)


def lab(colour, vision):
    x = XYZ @ np.clip(np.array(vision) @ linear_rgb(colour), 0, 1) / (XYZ @ np.ones(3))
    f = np.where(x > 216 / 24389, np.cbrt(x), (24389 / 27 * x + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def ciede2000(first, second):
    """Luo, Cui, Rigg 2001 in the form of Sharma, Wu, Dalal 2005, all weights 1."""
    (L1, a1, b1), (L2, a2, b2) = first, second

    def share(c):
        return np.sqrt(c**7 / (c**7 + 25.0**7))

    stretch = 1.5 - 0.5 * share((np.hypot(a1, b1) + np.hypot(a2, b2)) / 2)
    C1, C2 = np.hypot(stretch * a1, b1), np.hypot(stretch * a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, stretch * a)) % 360 for a, b in ((a1, b1), (a2, b2)))
    turn = (h2 - h1 + 180) % 360 - 180
    hue = (h1 + turn / 2) % 360  # the middle of the shorter arc
    L, C = (L1 + L2) / 2, (C1 + C2) / 2
    waves = ((1, -30, -0.17), (2, 0, 0.24), (3, 6, 0.32), (4, -63, -0.20))
    T = 1 + sum(w * np.cos(np.radians(k * hue + o)) for k, o, w in waves)
    light = (L2 - L1) / (1 + 0.015 * (L - 50) ** 2 / np.sqrt(20 + (L - 50) ** 2))
    chroma = (C2 - C1) / (1 + 0.045 * C)
    round_ = 2 * np.sqrt(C1 * C2) * np.sin(np.radians(turn / 2)) / (1 + 0.015 * C * T)
    rotation = -2 * share(C) * np.sin(np.radians(60 * np.exp(-(((hue - 275) / 25) ** 2))))
    return float(np.sqrt(light**2 + chroma**2 + round_**2 + rotation * chroma * round_))


def contrast(a, b):
    low, high = sorted(float(XYZ[1] @ linear_rgb(c)) + 0.05 for c in (a, b))
    return high / low


@pytest.mark.parametrize("vision", DEFICIENCIES)
def test_colours_are_apart_in_every_vision(vision):
    matrix = DEFICIENCIES[vision]
    for colours in (COLOURS, DARK):
        for a, b in combinations([lab(colour, matrix) for colour in colours], 2):
            assert min(ciede2000(a, b), np.linalg.norm(a - b)) > 20
    if vision == "deutan":  # the pair that the deficiency confuses is found
        assert ciede2000(*(lab(colour, matrix) for colour in ("#d1603d", "#9a7a2e"))) < 20
    # Sharma, Wu, Dalal 2005, Table 1, pair 25.
    pair = (60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387)
    assert ciede2000(*pair) == pytest.approx(1.2644, abs=5.1e-5)


def test_every_curve_has_a_second_cue():
    used = {route.colour for route in ROUTES.values() if "toy" not in route.method}
    assert {*used, SPLITTING.colour} == set(COLOURS) and len(COLOURS) == len(DARK) == 7
    assert len(MARKERS) == len(set(MARKERS.values())) == len(COLOURS)
    assert len(DASHES) == len(set(DASHES.values())) == 4


def test_curves_and_words_are_legible_in_both_schemes():
    light, dark, *_ = re.findall(r":root \{(.*?)\}", (TEMPLATES / "report.css").read_text())
    for text, curves in ((light, COLOURS), (dark, DARK)):
        own = dict(re.findall(r"--(\w+): (#[0-9a-f]{3,6})", text))
        for ground in (own["paper"], own["wash"]):
            assert (
                min(contrast(own[name], ground) for name in ("ink", "soft", "link", "bad")) >= 4.5
            )
        assert min(contrast(curve, own["paper"]) for curve in curves) >= 3.0
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)


def row(theory, reference, L1, error, observable="q2"):
    return {"theory": theory, "reference": reference, "L1": L1, "error": error,
            "observable": observable}  # fmt: skip


def curve(*rows, label="", incompatible="no h", modulation=None, transients=(), passages=()):
    return {
        "label": label,
        "averaging": rows,
        "regime": {"incompatible": incompatible},
        "system": {"modulation": modulation},
        "transients": transients,
        "passages": passages,
    }


def test_the_answer_takes_the_best_reference_and_the_worst_density():
    rows = (
        row("nonintegrable/simulation", "montecarlo", 0.0300, 1e-3),
        row("nonintegrable", "phase-space", 0.0126, 2e-4),
        row("nonintegrable", "montecarlo", 0.0061, 1e-4, "H"),
        row("integrable", "phase-space", 0.598, 2e-4),
    )
    # A bound is rounded up with its error: 1.28 % is within 1.3 %.
    expected = "Energy averaging is within 1.3 % of the full system, modal averaging is 60 % off."
    assert headline_of([curve(*rows)]) == expected
    assert headline_of([curve(*rows, label="B = 10")]).startswith("At B = 10: energy averaging is")
    near = row("nonintegrable", "montecarlo", 0.0996, 6e-4)
    assert "10 % off" in headline_of([curve(near)])  # with its error it may be beyond 10 %
    assert headline_of([curve()]) == ""
    assert "exact density" in headline_of([curve(incompatible=None)])
    assert measure_of([curve(incompatible=None)]) == ""
    both = headline_of([curve(*rows, incompatible=None)])
    assert "exact density is known" in both and both.endswith(expected)
    assert headline_of([curve(*rows, incompatible=None), curve()]) == expected


def test_under_modulated_noise_the_answer_is_about_the_times_asked_for():
    # A noise that ends with 0 leaves no stationary density: 0.69 % would be that of constant noise.
    modulated = {"modulation": {"times": [0.0, 8.0], "factor": [1.0, 0.0]}}
    stationary = row("nonintegrable", "montecarlo", 0.0061, 1e-4, "H")
    later = {"a": "nonintegrable/fem", "b": "montecarlo", "measures": "averaging", "L1": 0.34,
             "norm": "L1", "error": 0.01}  # fmt: skip
    chance = later | {"measures": "sampling", "L1": 0.9}
    asked = [{"question": "H from rest", "comparisons": [later, chance]}]
    expected = "At the times asked for: energy averaging is 34 % off."
    assert headline_of([curve(stationary, transients=asked, **modulated)]) == expected
    relative, chances = later | {"norm": "relative"}, later | {"norm": "absolute", "L1": 0.02}
    first = [{"question": "H=1 from rest", "comparisons": [relative, chances]}]
    both = curve(stationary, transients=asked, passages=first, **modulated)
    assert headline_of([both]) == expected and measure_of([both]).startswith("L1 distance")
    failing = [curve(stationary, passages=first, **modulated)]
    # 2 % and an error of 1 %: within 3 %.
    expected = (
        "In P(T > t) at the times asked for: energy averaging is within 3 % of the full system."
    )
    assert headline_of(failing) == expected and "P(T > t)" in measure_of(failing)
    alone = headline_of([curve(stationary, label="B = 10", **modulated)])
    assert alone.startswith("At B = 10, under constant noise: energy averaging is within 0.62 %")
    assert "under constant noise" in headline_of([curve(incompatible=None, **modulated)])


def test_stationary_numbers_of_a_modulated_scene_say_that_they_are_of_constant_noise():
    methods = [method_for(name, "closed-form") for name in ("nonintegrable", "integrable")]
    scenes = [replace(load_scene(n), passages=(), transients=()) for n in ("earthquake", "fig3a")]
    for scene, modulated in zip(scenes, (True, False), strict=True):
        digest = digest_of(run_scene(scene, methods))
        assert bool(digest["stationary_note"]) == modulated
        digest["averaging"] = [row("nonintegrable", "montecarlo", 0.01, 1e-3, "H")]
        for details in (True, False):
            text = " ".join(render("run.txt", {"digest": digest, "details": details}).split())
            note = text.find(CONSTANT_NOISE)
            assert modulated == (0 <= note < text.index("rms"))
        assert ("averaging error of H under constant noise: " in text) == modulated


def number(route, value, of="q2", quantity="rms"):
    kind = "sampling" if route == "montecarlo" else "numerical"
    return {"observable": of, "quantity": quantity, "label": quantity, "solves": "full",
            "route": route, "value": value, "error": 1e-3, "error_kind": kind}  # fmt: skip


def test_quantities_have_a_column_for_each_theory():
    routes = ("nonintegrable/closed-form", "nonintegrable/fem", "montecarlo")
    rows = [number(route, value) for route, value in zip(routes, (1.0, 1.1, 2.0), strict=True)]
    table = theory_table([*rows, number("nonintegrable/fem", 3.0, "H")])
    assert table["routes"] == ["energy averaging", "simulation"]
    one, energy = table["rows"]
    assert [cell["value"] for cell in one["cells"].values()] == [1.0, 2.0]
    # The closed form does not give H: another solver of the theory does.
    assert energy["of"] == "H" and energy["cells"]["energy averaging"]["value"] == 3.0
    assert theory_table([])["rows"] == []


def test_a_table_is_as_wide_as_the_terminal_and_repeats_no_solver():
    routes = ("phase-space", "nonintegrable/fem", "nonintegrable/closed-form", "montecarlo")
    quantities = ("mean", "contact probability, right stop")
    rows = [number(route, 0.5, quantity=name) for name in quantities for route in routes]
    wide = "\n".join(quantity_tables(rows, 100))
    assert wide.count("q2") == 1 and "elements" not in wide and "0.5000(10)" in wide
    assert "finite elements" in "\n".join(quantity_tables(rows, 100, True))
    for width in (60, 80, 120):
        lines = quantity_tables(rows, width, True)
        assert max(map(len, lines)) <= width
        assert sum(line.count("0.5000(10)") for line in lines) == len(rows)


def test_theories_claims_and_numbers_in_words():
    assert reader_words("nonintegrable/fem") == "energy averaging, finite elements"
    assert reader_words("nonintegrable (fem, quadrature)") == "energy averaging (fem, quadrature)"
    assert reader_words("integrable 5.9e-01") == "modal averaging 5.9e-01"
    assert reader_words("fpk density --method phase-space") == "fpk density --method phase-space"
    verdicts = ["undecided", "holds", "does not hold", "holds", "does not hold"]
    claims = [{"verdict": verdict} for verdict in verdicts]
    assert claims_counted(claims) == "2 hold, 2 do not hold, 1 undecided"
    assert claims_counted(claims[:2]) == "1 holds, 1 undecided"
    # The headline of a pair has an impact rate and no force.
    row = number("exact", 1.25, quantity="impact rate, left stop")
    curve = {"system": {"modulation": None}, "passages": [], "averaging_unknown": []}
    assert numbers_of({**curve, "quantities": [row]}).startswith("Q2 impact rate, left stop 1.25")
    force = number("exact", 1.25, quantity="mean force, left stop")
    assert "mean force, left stop 1.25" in numbers_of({**curve, "quantities": [row, force]})


def test_the_chain_is_drawn_with_its_stops():
    stops = (Contact(2, "both", 10.0, 0.5), Contact(1, "right", 1.0, 0.25))
    system = System([1, 1, 1], [1, 1, 1], [0.1] * 3, [0.1] * 3, contacts=stops)
    svg = chain_svg(system)
    assert svg.count('class="mass"') == 3 and svg.count("δ = 0.5") == 2
    assert svg.count('class="wall"') == 4  # three stops, and the wall that the chain hangs on
    assert chain_svg(system, Units("mm", "kg", "s")).count("δ = 0.5 mm") == 2
    long = System(np.ones(40), np.ones(40), np.full(40, 0.1), np.full(40, 0.1))
    assert chain_svg(long).count('class="mass"') == 8 and "first 8" in chain_svg(long)


def test_the_policy_allows_the_style_of_the_page_alone_and_a_long_chain_has_no_table_of_zeros(
    outcome,
):
    page = report_html(outcome.scene, digest_of(outcome), [])
    (style,) = re.findall(r"<style>(.*?)</style>", page, re.DOTALL)
    own = b64encode(sha256(style.encode()).digest()).decode()
    assert f"style-src 'sha256-{own}'" in page and "unsafe" not in page
    assert ' style="' not in page and "default-src 'none'" in page
    scene = load_scene("chain-50")
    long = run_scene(scene, [method_for("nonintegrable", "closed-form")])
    page = report_html(scene, digest_of(long), [])
    system = page[page.index("<dt>damping c") : page.index("<dt>contact 1")]
    assert system.count(", ") == 2 * 49


FEM, CLOSED = ROUTES["nonintegrable", "fem"], ROUTES["nonintegrable", "closed-form"]
MODAL, SAMPLED = ROUTES["integrable", "closed-form"], ROUTES["integrable", "simulation"]
MONTE_CARLO, LINEAR = ROUTES["montecarlo", "simulation"], ROUTES["linear", "closed-form"]


def test_solvers_of_one_theory_are_not_repeated():
    pairs = [
        (FEM, CLOSED, "numerical", False),
        (FEM, MONTE_CARLO, "averaging", False),
        (CLOSED, MONTE_CARLO, "averaging", True),
        (FEM, MODAL, "averaging", False),
        (MODAL, SAMPLED, "sampling", False),
        (ROUTES["integrable", "fem"], MONTE_CARLO, "averaging", False),
        (SAMPLED, MONTE_CARLO, "averaging", False),
    ]
    rows = comparison_rows(
        [Comparison("q2", a, b, kind, 0.1, None, 0.0) for a, b, kind, _ in pairs]
    )
    assert [r["repeats"] for r in rows] == [repeats for *_, repeats in pairs]


def test_one_reason_is_given_once():
    words = "H1: knows the total energy only"
    refusals = [
        Refusal(FEM, ("H1",), words),
        Refusal(ROUTES["nonintegrable", "quadrature"], ("H1", "H2"), words),
        Refusal(FEM, ("H2",), words.replace("H1", "H2")),
        Refusal(LINEAR, ("q2",), "has contacts"),
        Refusal(LINEAR, ("q1",), "has contacts", failed=True),
    ]
    first, second, third = refusals_of({"methods": list(map(refusal_record, refusals))})
    assert first == {
        "routes": "energy averaging (fem, quadrature)",
        "observables": ["H1", "H2"],
        "reason": "knows the total energy only",
        "failed": False,
        "gave_up": False,
        "methods": {"nonintegrable": {"fem": None, "quadrature": None}},
    }
    assert (second["routes"], second["failed"], third["failed"]) == ("Gaussian", False, True)
