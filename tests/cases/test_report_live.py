"""The page in a browser: its closed forms and values against Python, hover, toggles, keyboard."""

import json
import re
import shutil
import subprocess
from base64 import b64encode
from dataclasses import replace
from hashlib import sha256
from html import escape, unescape

import numpy as np
import pytest

from cases.comparison.routes import method_for
from cases.comparison.run import run_scene
from cases.comparison.stationary import answers_of
from cases.output.digest import digest_of
from cases.output.live import _model, as_script_data, live_record
from cases.output.page import TEMPLATES
from cases.output.records import plain
from cases.output.report import write_report
from cases.scene.scene import load_scene
from fpk import Contact, System
from fpk.observable import observable_name, parse_observable

FACTORS = {"B": 3.0, "delta": 0.6, "c": 1.7, "D": 0.4}
AT = {
    "q2": [-1.1, -0.3, 0.0, 0.29, 0.31, 0.9],
    "p1": [-0.4, 0.0, 0.7],
    "H": [0.001, 0.02, 0.2, 1.0],
}
OBSERVABLES = tuple(AT)

SCRIPT = """
const out = {values: {}, errors: []};
try {
  for (const [key, factors] of Object.entries(ASKED.factors)) {
    const forms = report.closedForms(factors);
    out.values[key] = {};
    for (const [of, points] of Object.entries(ASKED.at)) {
      const both = forms(of);
      out.values[key][of] = {energy: points.map(both.energy), modal: points.map(both.modal)};
    }
  }
  const [plot] = report.plots, panel = plot.panels[0];
  const press = key => panel.canvas.dispatchEvent(
    new KeyboardEvent("keydown", {key, bubbles: true, cancelable: true}));
  const paths = () => panel.canvas.querySelectorAll("path.curve").length;
  out.paths = [paths()];
  const [name] = Object.keys(plot.buttons);
  plot.buttons[name].click(); out.paths.push(paths());
  plot.buttons[name].click(); out.paths.push(paths());
  press("ArrowRight"); press("ArrowLeft"); press("ArrowRight");
  out.hover = plot.values();
  out.readout = plot.host.querySelector(".readout").textContent;
  press("l"); out.log = panel.log; press("l");
  press("+"); out.zoomed = plot.view.range; press("0"); out.whole = plot.view.range;
  const box = panel.canvas.getBoundingClientRect();
  const middle = box.left + 0.5 * (48 + box.width);
  panel.canvas.dispatchEvent(new PointerEvent("pointermove",
    {clientX: middle, clientY: box.top + 50, pointerType: "mouse", bubbles: true}));
  out.pointed = plot.view.cursor;
  const slider = document.querySelector("#sliders input[data-key=B]");
  slider.value = 1; slider.dispatchEvent(new Event("input"));
  out.afterSlider = paths(); out.B = document.querySelector("#sliders span").textContent;
  const begin = performance.now();
  for (let k = 0; k < 20; k++) {
    slider.value = 0.01 * k;
    slider.dispatchEvent(new Event("input"));
  }
  out.frame = (performance.now() - begin) / 20;
  out.wide = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  out.still = getComputedStyle(document.querySelector(".still")).display;
} catch (error) { out.errors.push(String(error.stack)); }
const pre = document.createElement("pre");
pre.id = "results"; pre.textContent = JSON.stringify(out);
document.body.append(pre);
"""


def asked(factors):
    return f"const ASKED = {json.dumps({'factors': factors, 'at': AT})};" + SCRIPT


@pytest.fixture(scope="module")
def chromium():
    path = shutil.which("chromium")
    if path is None:
        pytest.skip("chromium is not installed (Debian package chromium)")
    return path


@pytest.fixture(scope="module")
def outcome(scene_text, tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "any.toml"
    path.write_text(scene_text.replace('["q2", "H"]', '["q2", "p1", "H"]'))
    names = ("nonintegrable", "integrable")
    return run_scene(load_scene(str(path)), [method_for(m, "closed-form") for m in names])


def shown(chromium, page, script, folder, *options):
    """What the script has to say when it is added to the page, allowed by its hash."""
    own = b64encode(sha256(script.encode()).digest()).decode()
    page = page.replace("script-src ", f"script-src 'sha256-{own}' ", 1)
    path = folder / "page.html"
    page = page.replace("</body>", f"<script>{script}</script></body>")
    path.write_text(page, encoding="utf-8")
    command = [chromium, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
               f"--user-data-dir={folder / 'profile'}", *options,
               "--dump-dom", path.as_uri()]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    (text,) = re.findall(r'<pre id="results">(.*?)</pre>', done.stdout, re.DOTALL)
    return json.loads(unescape(text))


def varied(system, B=1.0, delta=1.0, c=1.0, D=1.0):
    """The system with its parameters times these factors."""
    contacts = tuple(
        replace(k, stiffness=B * k.stiffness, clearance=delta * k.clearance)
        for k in system.contacts
    )
    return replace(
        system, contacts=contacts, damping=c * system.damping,
        noise_intensity=D * system.noise_intensity,
    )  # fmt: skip


def by_python(system, method):
    observables = tuple(parse_observable(name, system.n) for name in OBSERVABLES)
    result = method_for(method, "closed-form", tol=1e-11).solve(system, observables)
    return {d.name: d(np.array(AT[d.name])) for d in result.densities}


def test_the_page_is_touched_and_its_numbers_are_those_of_python(chromium, outcome, tmp_path):
    write_report(outcome, digest_of(outcome), tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    cases = {"as run": {}, "varied": FACTORS}
    out = shown(chromium, page, asked(cases), tmp_path, "--window-size=1280,900")
    assert out["errors"] == []
    for key, factors in cases.items():
        system = varied(outcome.scene.system, **factors)
        for theory, method in (("energy", "nonintegrable"), ("modal", "integrable")):
            expected = by_python(system, method)
            for of in OBSERVABLES:
                got = np.array(out["values"][key][of][theory])
                assert np.max(np.abs(got / expected[of] - 1.0)) < 1e-9, (key, of, theory)
    # Another clearance is seen: the comparison can fail.
    wrong = by_python(varied(outcome.scene.system, delta=0.9), "nonintegrable")["q2"]
    assert np.max(np.abs(np.array(out["values"]["as run"]["q2"]["energy"]) / wrong - 1)) > 1e-3

    assert out["paths"] == [2, 1, 2]
    x = np.array([v["x"] for v in out["hover"]])
    for v, density in zip(out["hover"], outcome.curves[0].of("q2").values(), strict=True):
        value, error = density.at(x[:1])
        assert v["p"] == pytest.approx(value[0], rel=1e-9) and v["error"] >= error[0]
        assert v["name"] in out["readout"] and "±" in out["readout"]
    assert out["log"] is True and out["whole"] is None and len(out["zoomed"]) == 2
    assert abs(out["pointed"]) < 0.02  # the middle of the axes, to a pixel
    assert out["afterSlider"] == 4 and out["B"].endswith("B = 100")
    assert out["wide"] == 0 and out["still"] == "none"


LAWS = (("hertz", None), ("bilinear", None), ("power", 2.0), ("power", 1.2), ("power", 3.7))


def drawn_answers(k, random):
    """Answers to a random chain of 1 to 4 masses with stops of every law, side and clearance."""
    n, (law, exponent) = 1 + k % 4, LAWS[k % len(LAWS)]
    mass, side = int(random.integers(1, n + 1)), ("both", "left", "right")[k % 3]
    stops = [Contact(mass, side, 10 ** random.uniform(-1, 3), (0.0, 0.3, 2.0)[k // 2 % 3], law=law,
                     exponent=exponent)]  # fmt: skip
    if side == "right":
        stops.append(Contact(mass, "left", 3.0, 0.7))
    numbers = (random.uniform(*ends, n) for ends in ((0.5, 2), (0.5, 2), (0.02, 0.1), (0.01, 0.05)))
    system = System(*numbers, contacts=tuple(stops))
    observables = [parse_observable(name, n) for name in (f"q{mass}", "p1", "H")]
    methods = [method_for(m, "closed-form", tol=1e-11) for m in ("nonintegrable", "integrable")]
    return answers_of(system, observables, methods), observables


@pytest.mark.slow
def test_closed_forms_of_drawn_systems_are_those_of_python(chromium, tmp_path):
    random, jobs, expected = np.random.default_rng(20040809), [], []
    for k in range(6):
        answers, observables = drawn_answers(k, random)
        model = plain(_model(answers, observables))
        for name in map(observable_name, observables):
            p = answers[name, "nonintegrable/closed-form"]
            at = np.array([0.01, 0.3, 1.0, 2.5]) * np.sqrt(p.expectation(np.square).value)
            jobs.append({"model": model, "of": name, "at": at.tolist()})
            expected.append((p, answers.of(name).get("integrable/closed-form"), at))
    page = "<!doctype html><body></body>"
    forms = (TEMPLATES / "closed_forms.js").read_text(encoding="utf-8")
    script = (
        forms
        + """
    const pre = document.createElement("pre");
    pre.id = "results";
    pre.textContent = JSON.stringify(JOBS.map(({model, of, at}) => {
      const both = closedForms(model, AS_RUN)(of);
      return [at.map(both.energy), both.modal && at.map(both.modal)];
    }));
    document.body.append(pre);
    """.replace("JOBS", json.dumps(jobs))
    )
    found = shown(chromium, page, script, tmp_path)
    for got, (energy, modal, at) in zip(found, expected, strict=True):
        # Both are sums of positive terms; nodes and round-off leave 1e-13.
        np.testing.assert_allclose(got[0], energy(at), rtol=1e-11)
        if got[1] is not None and modal is not None:
            np.testing.assert_allclose(got[1], modal(at), rtol=1e-11)
    assert sum(got[1] is not None for got in found) >= 12


def test_nothing_is_wider_than_a_telephone_and_paper_has_the_drawn_pictures(
    chromium, outcome, tmp_path
):
    write_report(outcome, digest_of(outcome), tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    script = """
    const frame = document.querySelector("iframe"), page = frame.contentDocument;
    for (const d of page.querySelectorAll("details")) d.open = true;
    const beyond = [...page.querySelectorAll("body *")].filter(e => !e.closest("svg") &&
      e.getBoundingClientRect().right > page.documentElement.clientWidth + 1);
    const small = [...page.querySelectorAll("svg text")].map(
      e => e.getBoundingClientRect()).filter(r => r.height > 0 && Math.min(r.height, r.width) < 6);
    const pre = document.createElement("pre");
    pre.id = "results";
    pre.textContent = JSON.stringify({beyond: beyond.map(e => e.outerHTML.slice(0, 90)),
      live: page.querySelectorAll(".live").length, small: small.length,
      bodies: page.querySelectorAll("td").length});
    document.body.append(pre);
    """
    # A window is never narrower than 500 pixels, a frame is; its content has the frame's origin.
    for width in (390, 1280):
        frame = f'<iframe width="{width}" height="800" srcdoc="{escape(page)}"></iframe>'
        late = f"addEventListener('load', () => {{ {script} }});"
        out = shown(chromium, f"<!doctype html><body>{frame}</body>", late, tmp_path)
        assert out["beyond"] == [] and out["live"] == 3 and out["bodies"] > 30
        assert out["small"] == 0
    assert "@media print { .live, #sliders { display: none; }" in page


def test_the_data_are_those_of_the_densities_and_end_no_element(outcome):
    record = live_record(outcome)
    assert [plot["of"] for plot in record["plots"]] == list(OBSERVABLES)
    first = record["plots"][0]
    density = outcome.curves[0].of("q2")["nonintegrable/closed-form"]
    values, errors = density.at(np.array(first["x"]))
    np.testing.assert_allclose(first["series"][0]["p"], values, rtol=5.1e-10)  # ten digits
    assert np.all(np.array(first["series"][0]["error"]) >= errors)
    assert record["model"]["n"] == 2 and first["walls"] == [-0.5, 0.5]
    text = as_script_data({"a": "</script><!-- & \u2028"})
    assert not set("<>&\u2028") & set(text) and json.loads(text)["a"] == "</script><!-- & \u2028"


def test_closed_forms_are_offered_only_where_they_hold(outcome, scene_text, tmp_path):
    term = "\n[[damping_term]]\ni = 1\nj = 1\ncoefficient = 0.05\nq = { 1 = 2 }\n"
    path = tmp_path / "any.toml"
    path.write_text(scene_text + term)
    other = run_scene(load_scene(str(path)), [method_for("nonintegrable")])
    assert live_record(other)["model"] is None
    linear = re.sub(r"\[\[contact\]\].*?\n\n", "", scene_text, flags=re.DOTALL)
    path.write_text(linear)
    other = run_scene(load_scene(str(path)), [method_for("integrable")])
    assert live_record(other)["model"] is None
