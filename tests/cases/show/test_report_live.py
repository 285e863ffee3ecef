"""The page in a browser: its closed forms and values against Python, hover, toggles, keyboard."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from cases.compare.routes import method_for
from cases.compare.stationary import answers_of, run_scene
from cases.scene.scene import load_scene
from cases.show.digest import digest_of
from cases.show.page import TEMPLATES, as_script_data
from cases.show.records import plain
from cases.show.report import live_record, write_report
from cases.show.slider_model import slider_model
from fpk import Contact, System
from fpk.answer.names import observable_name, parse_observable

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
  const out = {values: {}};
  for (const [key, factors] of Object.entries(ASKED.factors)) {
    const forms = report.closedForms(factors);
    out.values[key] = {};
    for (const [of, points] of Object.entries(ASKED.at)) {
      const both = forms(of);
      const values = ([theory, f]) => [theory, points.map(f)];
      out.values[key][of] = Object.fromEntries(Object.entries(both).map(values));
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
  press("+"); out.zoomed = plot.view.x; press("0"); out.whole = plot.view.x;
  const box = panel.canvas.getBoundingClientRect();
  const middle = box.left + 0.5 * (panel.frame.left + panel.frame.right);
  panel.canvas.dispatchEvent(new PointerEvent("pointermove",
    {clientX: middle, clientY: box.top + 50, pointerType: "mouse", bubbles: true}));
  out.pointed = plot.view.cursor.x;
  const slider = document.querySelector("#sliders input[data-key=B]");
  slider.value = 1; slider.dispatchEvent(new Event("input"));
  out.afterSlider = paths(); out.B = document.querySelector("#sliders span").textContent;
  out.slid = plot.values().filter(v => v.name.includes("sliders"));
  out.labels = [...document.querySelectorAll("#sliders span")].map(e => e.textContent);
  document.querySelector("#sliders button").click(); out.reset = report.factors;
  out.wide = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  out.still = getComputedStyle(document.querySelector(".still")).display;
  return out;
"""


@pytest.fixture(scope="module")
def outcome(scene_text, tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "any.toml"
    path.write_text(scene_text.replace('["q2", "H"]', json.dumps(OBSERVABLES)))
    names = ("nonintegrable", "integrable")
    return run_scene(load_scene(str(path)), [method_for(m, "closed-form") for m in names])


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


def test_the_page_is_touched_and_its_numbers_are_those_of_python(browser, outcome, tmp_path):
    write_report(outcome, digest_of(outcome), tmp_path)
    cases = {"as run": {}, "varied": FACTORS}
    browser.open((tmp_path / "report.html").as_uri(), width=1280)
    out = browser.result(f"const ASKED = {json.dumps({'factors': cases, 'at': AT})};" + SCRIPT)
    for key, factors in cases.items():
        system = varied(outcome.scene.system, **factors)
        for theory, method in (("energy", "nonintegrable"), ("modal", "integrable")):
            expected = by_python(system, method)
            for of in expected:
                got = np.array(out["values"][key][of][theory])
                assert np.max(np.abs(got / expected[of] - 1.0)) < 1e-9, (key, of, theory)
    # Another clearance is seen: the comparison can fail.
    wrong = by_python(varied(outcome.scene.system, delta=[0.9]), "nonintegrable")["q2"]
    assert np.max(np.abs(np.array(out["values"]["as run"]["q2"]["energy"]) / wrong - 1)) > 1e-3

    assert out["paths"] == [2, 1, 2]
    x = np.array([v["x"] for v in out["hover"]])
    for v, density in zip(out["hover"], outcome.curves[0].of("q2").values(), strict=True):
        value, error = density.at(x[:1])
        assert v["p"] == pytest.approx(value[0], rel=1e-9) and v["error"] >= error[0]
        assert v["name"] in out["readout"] and "±" in out["readout"]
    assert out["log"] is True and out["whole"] is None and len(out["zoomed"]) == 2
    step = np.diff(live_record(outcome)["plots"][0]["x"])[0]
    assert abs(out["pointed"]) < 0.5 * step + 0.02  # the middle of the axes, to a pixel
    assert out["afterSlider"] == 4 and out["B"].endswith("B = 100")
    x = out["slid"][0]["x"]
    stiffer = varied(outcome.scene.system, B=[10.0])
    solved = method_for("nonintegrable", "closed-form", tol=1e-11).solve(
        stiffer, (parse_observable("q2", 2),)
    )
    value = solved.densities[0](np.array([x]))[0]
    assert abs(out["slid"][0]["p"] - value) <= out["slid"][0]["error"] < 1e-9 * value
    assert len(out["labels"]) == 6 and "damping c₂ = 0.04" in out["labels"]
    assert out["reset"] == {"B": [1], "delta": [1], "c": [1, 1], "D": [1, 1]}
    assert out["wide"] == 0 and out["still"] == "none"


LAWS = (("hertz", None), ("bilinear", None), ("power", 2.0), ("power", 1.2), ("power", 3.7))


def drawn_answers(k, random):
    """A random chain of 1 to 4 masses with stops of every law, side and clearance, and answers.

    Its record has the factors of the sliders; the answers are those with these factors.
    """
    n, (law, exponent) = 1 + k % 4, LAWS[k % len(LAWS)]
    mass, side = int(random.integers(1, n + 1)), ("both", "left", "right")[k % 3]
    stops = [Contact(mass, side, 10 ** random.uniform(-1, 3), (0.0, 0.3, 2.0)[k // 2 % 3], law=law,
                     exponent=exponent)]  # fmt: skip
    if side == "right":
        stops.append(Contact(mass, "left", 3.0, 0.7))
    numbers = (random.uniform(*ends, n) for ends in ((0.5, 2), (0.5, 2), (0.02, 0.1), (0.01, 0.05)))
    gain = random.normal(size=(n, n)) if k % 2 else None
    system = System(*numbers, contacts=tuple(stops), noise_gain=gain)
    observables = [parse_observable(f"q{k}", n) for k in range(1, n + 1)]
    observables += [parse_observable(name, n) for name in ("p1", "H", "H1")]
    methods = [method_for(m, "closed-form", tol=1e-11) for m in ("nonintegrable", "integrable")]
    as_run = answers_of(system, observables, methods[1:] if k % 6 == 5 else methods)
    sizes = {"B": len(stops), "delta": len(stops), "c": n, "D": n}
    factors = {key: 10 ** random.uniform(-0.5, 0.5, size) for key, size in sizes.items()}
    return plain(slider_model(as_run, observables)[0]), factors, answers_of(
        varied(system, **factors), observables, methods
    ), observables  # fmt: skip


@pytest.mark.slow
def test_closed_forms_of_drawn_systems_are_those_of_python(browser):
    random, jobs, expected = np.random.default_rng(20040809), [], []
    for k in range(8):
        model, factors, answers, observables = drawn_answers(k, random)
        if k == 5:
            assert model is None  # without energy averaging there are no sliders
            continue
        for name in map(observable_name, observables):
            own = {"energy": "nonintegrable/closed-form", "modal": "integrable/closed-form"}
            solved = {theory: answers.of(name).get(route) for theory, route in own.items()}
            forms = model["of"].get(name, {"forms": ()})["forms"]
            solved = {theory: p for theory, p in solved.items() if theory in forms and p}
            assert "modal" in solved or not model["frequency"] or resonant(answers)
            if not solved:
                continue
            p = next(iter(solved.values()))
            at = np.array([0.01, 0.3, 1.0, 2.5]) * np.sqrt(p.expectation(np.square).value)
            jobs.append(plain({"model": model, "factors": factors, "of": name, "at": at}))
            expected.append((solved, at, resonant(answers)))
    forms = (TEMPLATES / "closed_forms.js").read_text(encoding="utf-8")
    script = """
    return JOBS.map(({model, factors, of, at}) => {
      const forms = closedForms(model, factors);
      const values = ([theory, f]) => [theory, at.map(f)];
      return [forms.resonant, Object.fromEntries(Object.entries(forms(of)).map(values))];
    });
    """
    browser.open("about:blank", width=1280)
    found = browser.result(f"{forms} const JOBS = {json.dumps(jobs)};" + script)
    assert {True, False} == {refused for *_, refused in expected}
    for job, (flag, got), (solved, at, refused) in zip(jobs, found, expected, strict=True):
        assert flag is refused or not job["model"]["frequency"]
        for theory, p in solved.items():
            value, error = p.at(at)
            # Both are sums of positive terms; nodes and round-off leave 1e-11.
            assert np.all(np.abs(got[theory] - value) <= error + 1e-11 * value), (theory, at)
    assert sum(len(solved) for solved, *_ in expected) > 40


def resonant(answers):
    """Whether modal averaging is refused for its internal resonance."""
    return any("internal resonance" in r.reason for r in answers.refused)


def test_the_data_are_those_of_the_densities_and_end_no_element(outcome):
    record = live_record(outcome)
    assert [plot["of"] for plot in record["plots"]] == list(OBSERVABLES)
    first = record["plots"][0]
    density = outcome.curves[0].of("q2")["nonintegrable/closed-form"]
    values, errors = density.at(np.array(first["x"]))
    np.testing.assert_allclose(first["series"][0]["y"], values, rtol=5.1e-10)  # ten digits
    assert np.all(np.array(first["series"][0]["error"]) >= errors)
    assert record["model"]["n"] == 2 and first["stops"] == [-0.5, 0.5]
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
