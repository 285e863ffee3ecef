"""The page in a browser: its closed forms and values against Python, hover, toggles, keyboard."""

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
