"""The page in a browser: schemes, a telephone, paper; closed forms and sliders against Python."""

import json
from dataclasses import replace

import numpy as np
import pytest

from averaging.modal.analysis import modal_analysis
from averaging.modal.resonance import correlations
from cases.compare.routes import method_for
from cases.show.digest import digest_of
from cases.show.page import as_script_data
from cases.show.report import live_record, write_report
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable

OPEN = "document.querySelectorAll('details').forEach(d => d.open = true);"
"""Unfolds what is folded."""

SEEN = """
const parts = [...document.querySelectorAll("body *")];
const seen = e => e.checkVisibility({visibilityProperty: true}) &&
  e.getBoundingClientRect().height > 0;
"""
"""All elements, and whether one of them is seen."""

CONTRAST = (
    SEEN
    + """
const channels = colour => colour.match(/[\\d.]+/g).map(Number);
const over = ([r, g, b, a = 1], ground) => [r, g, b].map((c, i) => a * c + (1 - a) * ground[i]);
const ground = e => {
  const under = e.parentElement ? ground(e.parentElement) : [255, 255, 255];
  return over(channels(getComputedStyle(e).backgroundColor), under);
};
const opacity = e => e ? getComputedStyle(e).opacity * opacity(e.parentElement) : 1;
const luminance = rgb => rgb.map(c => c / 255).map(
  c => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4
).reduce((sum, c, i) => sum + c * [0.2126, 0.7152, 0.0722][i], 0);
const contrast = e => {
  const under = ground(e), style = getComputedStyle(e);
  const [r, g, b, a = 1] = channels(e.closest("svg") ? style.fill : style.color);
  const [x, y] = [over([r, g, b, a * opacity(e)], under), under].map(luminance);
  return (Math.max(x, y) + 0.05) / (Math.min(x, y) + 0.05);
};
const words = parts.filter(e => seen(e) && [...e.childNodes].some(n => n.nodeType === 3 &&
  n.textContent.trim()));
"""
)
"""Contrast of an element's text with what is under it, as the browser colours both."""


@pytest.fixture(scope="module")
def page(outcome, tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    write_report(outcome, digest_of(outcome), folder)
    return (folder / "report.html").as_uri()


def test_words_are_legible_and_curves_have_other_colours_on_a_dark_page(browser, page):
    shown = []
    for dark in (False, True):
        browser.open(page, width=1280, dark=dark)
        curves = "[...document.querySelectorAll('.curve')].map(e => getComputedStyle(e).stroke)"
        shown.append(set(browser.value(curves)))
        ratio, count, paper = browser.result(
            OPEN + CONTRAST + "return [Math.min(...words.map(contrast)), words.length,"
            " luminance(ground(document.body))];"
        )
        assert count > 200 and ratio >= 4.5
        assert (paper < 0.02) is dark
        # Pale words are found: the measure can fail.
        pale = "document.querySelector('h1').style.color = '#777';"
        assert browser.result(pale + CONTRAST + "return Math.min(...words.map(contrast));") < 4.5
    assert len(shown[0]) == len(shown[1]) == 2 and not shown[0] & shown[1]


@pytest.mark.parametrize(("script", "dark"), [(True, True), (False, False)])
def test_paper_has_the_pictures_in_dark_ink_and_no_sliders(browser, page, script, dark):
    browser.open(page, width=718, script=script, dark=dark, paper=True)
    drawn, controls, paper, ink, strokes = browser.result(
        CONTRAST
        + """
        const drawn = [...document.querySelectorAll("figure img, .pair > svg")].filter(seen);
        const controls = parts.filter(e => e.matches("input") && seen(e));
        const strokes = [...document.querySelectorAll('[stroke="#e07500"]')].filter(seen).map(
          e => getComputedStyle(e).stroke);
        return [drawn.length, controls.length, luminance(ground(document.body)),
          luminance(channels(getComputedStyle(document.body).color)), [...new Set(strokes)]];"""
    )
    assert drawn >= 4 and controls == 0 and paper == 1.0 and ink == 0.0
    assert strokes == (["rgb(224, 117, 0)"] if script else [])
    assert browser.pdf().startswith(b"%PDF")


LABELS = (
    SEEN
    + """
const rows = [...document.querySelectorAll("tr")].filter(r => r.querySelector("td") && seen(r));
const label = cell => getComputedStyle(cell, "::before").content.replaceAll('"', "");
return rows.flatMap(row => {
  const heads = [...row.closest("table").querySelectorAll("th")].map(e => e.textContent);
  return [...row.cells].map((cell, k) => ({label: label(cell), head: heads[k],
    columns: heads.length - row.cells.length, text: cell.textContent,
    left: getComputedStyle(cell).textAlign, key: cell.matches(".keyed td:first-child")}));
});"""
)
"""What stands beside each cell of a table, and the head of its column."""


def test_on_a_telephone_every_cell_has_the_head_of_its_column_beside_it(browser, page):
    browser.open(page, width=390, height=844, script=False)
    cells = browser.result(OPEN + LABELS)
    assert len(cells) > 150 and all(c["columns"] == 0 for c in cells)
    assert {c["head"] for c in cells} > {"--method", "L1 error", "energy averaging", "quantity"}
    for cell in cells:
        assert cell["label"] == cell["head"] or cell["key"] or not cell["text"]
    browser.open(page, width=1280, script=False)
    wide = browser.result(OPEN + LABELS)
    assert {c["label"] for c in wide} == {"none"}
    # Numbers stand at the right.
    right = {c["head"] for c in wide if c["left"] == "right"}
    assert {"energy averaging", "difference", "seconds"} < right
    assert not right & {"quantity", "theory", "settings", "certified", "measures"}


FACTORS = {"B": [3.0], "delta": [0.6], "c": [1.2, 0.8], "D": [0.6, 0.9]}
AT = {
    "q2": [-1.1, -0.3, 0.0, 0.29, 0.31, 0.9],
    "q1": [-1.3, 0.0, 0.4, 2.0],
    "p1": [-0.4, 0.0, 0.7],
    "H": [0.001, 0.02, 0.2, 1.0],
    "H2": [0.0, 0.1, 1.0],
}
OBSERVABLES = tuple(AT)

SCRIPT = """
  const out = {values: {}, resonant: {}, neglected: {}};
  for (const [key, factors] of Object.entries(ASKED.factors)) {
    const forms = report.closedForms(factors);
    out.values[key] = {}; out.resonant[key] = forms.resonant; out.neglected[key] = forms.neglected;
    for (const [of, points] of Object.entries(ASKED.at)) {
      const both = forms(of);
      const values = ([theory, f]) => [theory, points.map(f)];
      out.values[key][of] = Object.fromEntries(Object.entries(both).map(values));
    }
  }
  const [plot] = report.plots;
  const paths = () => plot.panels[0].canvas.querySelectorAll("path.curve").length;
  plot.panels[0].canvas.dispatchEvent(
    new KeyboardEvent("keydown", {key: "ArrowRight", bubbles: true, cancelable: true}));
  out.paths = paths();
  const slider = document.querySelector("#sliders input[data-key=B]");
  slider.value = 1; slider.dispatchEvent(new Event("input"));
  out.afterSlider = paths(); out.B = document.querySelector("#sliders span").textContent;
  out.slid = plot.values().filter(v => v.name.includes("sliders"));
  out.labels = [...document.querySelectorAll("#sliders span")].map(e => e.textContent);
  document.querySelector("#sliders button").click(); out.reset = report.factors;
  return out;
"""


def varied(system, B=(1.0,), delta=(1.0,), c=1.0, D=1.0):
    """The system with its parameters times these factors, each of a contact or a mass."""
    contacts = tuple(
        replace(k, stiffness=b * k.stiffness, clearance=d * k.clearance)
        for k, b, d in zip(system.contacts, B, delta, strict=True)
    )
    return replace(
        system, contacts=contacts, damping=np.diag(np.diag(system.damping) * c),
        noise_intensity=np.diag(np.diag(system.noise_intensity) * D),
    )  # fmt: skip


def by_python(system, method):
    names = [name for name in OBSERVABLES if name != "H2" or method == "integrable"]
    observables = tuple(parse_observable(name, system.n) for name in names)
    result = method_for(method, "closed-form", tol=1e-11).solve(system, observables)
    return {d.name: d(np.array(AT[d.name])) for d in result.densities}


DAMPED = {"c": [25.0, 25.0]}
"""So much that the modes of the scene are no longer apart: modal averaging is refused."""
LEFT = ('"both"', '"left"\nlaw = "power"\nexponent = 2.2')
SCENES = {
    "hertz": [],
    "power, at rest, coupled noise": [
        LEFT, ("clearance = 0.5", "clearance = 0.0"),
        ("[[contact]]", "noise_gain = [[1.0, 0.2], [0.0, 1.0]]\n[[contact]]"),
    ],
    "bilinear": [('"both"', '"right"\nlaw = "bilinear"')],
}  # fmt: skip


@pytest.fixture
def page_says(browser, solved, scene_text, tmp_path):
    """The system of one of ``SCENES``, and what the page of its run answers to the script."""

    def ask(name):
        text = scene_text.replace('["q2", "H"]', json.dumps(OBSERVABLES))
        for old, new in SCENES[name]:
            text = text.replace(old, new)
        outcome = solved(text, "nonintegrable/closed-form", "integrable/closed-form")
        write_report(outcome, digest_of(outcome), tmp_path)
        browser.open((tmp_path / "report.html").as_uri(), width=1280)
        asked = {"factors": {"as run": {}, "varied": FACTORS, "damped": DAMPED}, "at": AT}
        answers = browser.result(f"const ASKED = {json.dumps(asked)};" + SCRIPT)
        return outcome.scene.system, answers

    return ask


@pytest.mark.parametrize("name", SCENES)
def test_closed_forms_are_those_of_python(name, page_says):
    system, out = page_says(name)
    for key, factors in (("as run", {}), ("varied", FACTORS), ("damped", DAMPED)):
        largest = correlations(modal_analysis(varied(system, **factors))).max()
        assert out["neglected"][key] == pytest.approx(largest, rel=1e-9)
    for key, factors in (("as run", {}), ("varied", FACTORS)):
        for theory, method in (("energy", "nonintegrable"), ("modal", "integrable")):
            for of, expected in by_python(varied(system, **factors), method).items():
                got = np.array(out["values"][key][of][theory])
                assert np.max(np.abs(got / expected - 1.0)) < 1e-9, (key, of, theory)
    assert out["resonant"] == {"as run": False, "varied": False, "damped": True}
    with pytest.raises(NotApplicable, match="internal resonance"):
        by_python(varied(system, **DAMPED), "integrable")
    if name == "hertz":  # another clearance is seen: the comparison can fail
        wrong = by_python(varied(system, delta=[0.9]), "nonintegrable")["q2"]
        assert np.max(np.abs(np.array(out["values"]["as run"]["q2"]["energy"]) / wrong - 1)) > 1e-3


def test_sliders_are_moved(page_says):
    system, out = page_says("hertz")
    assert out["paths"] == 2
    assert out["afterSlider"] == 4 and out["B"].endswith("B = 100")
    slid = out["slid"][0]
    method = method_for("nonintegrable", "closed-form", tol=1e-11)
    stiffer = varied(system, B=[10.0])
    (density,) = method.solve(stiffer, (parse_observable("q2", 2),)).densities
    value = density(np.array([slid["x"]]))[0]
    assert abs(slid["p"] - value) <= slid["error"] < 1e-9 * value
    assert len(out["labels"]) == 6 and "damping c₂ = 0.04" in out["labels"]
    assert out["reset"] == {"B": [1], "delta": [1], "c": [1, 1], "D": [1, 1]}


def test_data_end_no_element():
    text = as_script_data({"a": "</script><!-- & \u2028"})
    assert not set("<>&\u2028") & set(text) and json.loads(text)["a"] == "</script><!-- & \u2028"


def test_closed_forms_are_offered_only_where_they_hold(solved, scene_text, linear_text):
    term = "\n[[damping_term]]\ni = 1\nj = 1\ncoefficient = 0.05\nq = { 1 = 2 }\n"
    assert live_record(solved(scene_text + term, "nonintegrable/fem"))["model"] is None
    assert live_record(solved(linear_text, "integrable/closed-form"))["model"] is None
