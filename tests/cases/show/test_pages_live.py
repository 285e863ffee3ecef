"""Maps, answers in time and pages of studies in a browser: numbers, hover, keyboard, toggles."""

import json
from itertools import combinations

import numpy as np
import pytest

import fpk as face
from cases.scene.scene import load_scene
from cases.show.digest import digest_of
from cases.show.pictures.draw import study_figure
from cases.show.pictures.panel import Curve, Field, Panel, live_plots
from cases.show.report import live_record, write_report
from cases.show.words import reader_words
from cases.study.cost import CostStudy
from cases.study.levels import Level
from cases.study.prices import Priced
from cases.study.regime_map import build_map
from fpk.numeric.arrays import EPS

QUESTIONS = """
[[passage]]
limit = "H=1.0"
times = [5.0, 20.0, 60.0]

[[transient]]
of    = "H"
times = [10.0, 40.0]
"""

SCRIPT = """
const plots = [];
const key = (panel, ...keys) => keys.forEach(k => panel.canvas.dispatchEvent(
  new KeyboardEvent("keydown", {key: k, bubbles: true, cancelable: true})));
const pointed = (panel, x, y) => {
  const box = panel.canvas.getBoundingClientRect(), size = panel.canvas.viewBox.baseVal.width;
  panel.canvas.dispatchEvent(new PointerEvent("pointermove", {pointerType: "mouse", bubbles: true,
    clientX: box.left + panel.frame.X.to(x) * box.width / size,
    clientY: box.top + panel.frame.Y.to(y) * box.width / size}));
};
const drawn = ".pair > svg, .pair path.curve, .pair .marks";
const visible = plot => [...plot.host.querySelectorAll(drawn)].filter(
  e => getComputedStyle(e).display !== "none" && e.getBoundingClientRect().width).length;
const told = plot => ({
  values: plot.values(), place: {x: plot.view.cursor.x, y: plot.view.cursor.y},
  words: plot.host.querySelector(".readout").textContent});
for (const p of report.plots) {
  const [panel] = p.panels, {plot} = p, own = {id: plot.id, hover: [], visible: [visible(p)]};
  const s = (plot.fields || plot.series)[0];
  if (plot.fields) pointed(panel, plot.x[plot.x.length >> 1], plot.y[plot.y.length >> 1]);
  else pointed(panel, s.x[1], s.y[1]);
  own.hover.push(told(p));
  key(panel, "ArrowRight", "ArrowUp");
  own.hover.push(told(p));
  for (const node of Object.values(p.buttons)) {
    node.click(); own.visible.push(visible(p)); node.click();
  }
  own.visible.push(visible(p));
  own.log = [panel.log]; key(panel, "l"); own.log.push(panel.log); key(panel, "l");
  const whole = {...panel.frame.X};
  key(panel, "+");
  own.ends = [whole.low, panel.frame.X.low, panel.frame.X.high, whole.high];
  key(panel, "0"); own.whole = [panel.frame.X.low, panel.frame.X.high];
  key(panel, "Escape"); own.cursor = p.view.cursor;
  own.said = [...p.host.querySelectorAll("p")].map(e => e.textContent).join(" ");
  own.image = p.host.querySelector("image")?.getAttribute("href").slice(0, 22);
  plots.push(own);
}
return plots;
"""


def priced(route, *points):
    levels = [Level(f"setting {k}", e, 2 * e, s, spread=s / 9) for k, (e, s) in enumerate(points)]
    return Priced(route, "averaged equation (24)", "L1", tuple(levels))


@pytest.fixture(scope="module")
def outcome(solved, scene_text):
    text = scene_text.replace('["q2", "H"]', '["q2", "q2,p2", "H1,H2"]') + QUESTIONS
    return solved(text, "nonintegrable/fem", "integrable/closed-form")


@pytest.fixture(scope="module")
def sweeps():
    scene = load_scene("fig3a")
    both = {"contact.clearance": [0.3, 0.5, 1.0], "contact.stiffness": [1.0, 10.0, 100.0]}
    one = {"contact.clearance": both["contact.clearance"]}
    wanted = ["rms(q2)", "exceedance(q2,0.5)"]
    return scene, [face.sweep(scene, axes, wanted) for axes in (one, both)]


@pytest.fixture(scope="module")
def study(outcome):
    coarse = priced("coarse", (0.2, 1e-3), (1e-5, 3e-3), (1e-9, 0.1))
    floors = {"averaged equation (24)": 1e-13}
    named_by_key = priced("nonintegrable/fem", (1e-12, 2.0))
    return CostStudy(outcome.scene, [coarse, named_by_key], floors=floors)


@pytest.fixture(scope="module")
def pages(outcome, sweeps, study, units_text, tmp_path_factory):
    """Addresses of the pages as they are written, by name."""
    folder = tmp_path_factory.mktemp("pages")
    write_report(outcome, digest_of(outcome), folder)
    found = {"report": (folder / "report.html").as_uri()}
    scene, (one, two) = sweeps
    regime = build_map(scene, ["contact.clearance=0.5,1", "contact.stiffness=1,10,100"])
    (folder / "named.toml").write_text(f"{scene.text}\n{units_text}", "utf-8")
    grid = {"contact[1].clearance": [0.3, 0.5, 1.0], "system.noise_intensity": [0.123456, 0.5, 1.0]}
    named = load_scene(str(folder / "named.toml"))
    units = face.sweep(named, grid, ["rms(q2)", "force_in_contact(1)"]).page()
    studies = {"line": one.page(), "heat": two.page(), "units": units}
    for name, page in {**studies, "regime": regime.page(), "cost": study.page()}.items():
        (folder / name).mkdir()
        page.write(folder / name)
        found[name] = (folder / name / f"{page.name}.html").as_uri()
    return found


@pytest.fixture(scope="module")
def touched(browser, pages):
    """What every plot of every page says when it is touched, by page and identifier."""
    found = {}
    for name, url in pages.items():
        browser.open(url, width=1100)
        found[name] = {plot["id"]: plot for plot in browser.result(SCRIPT)}
    return found


def test_every_plot_answers_to_the_pointer_keys_and_buttons(touched):
    count = {name: len(plots) for name, plots in touched.items()}
    assert count == {"report": 5, "line": 2, "heat": 1, "regime": 1, "cost": 1, "units": 1}
    for plot in (plot for plots in touched.values() for plot in plots.values()):
        first, *off, last = plot["visible"]
        assert first == last and min(off) < first
        assert plot["log"][0] is not plot["log"][1] and plot["cursor"] is None
        low, zoomed, end, high = plot["ends"]
        assert low <= zoomed < end <= high and (low, high) != (zoomed, end)
        assert plot["whole"] == [low, high]
        assert plot["hover"][0]["place"] != plot["hover"][1]["place"]
        for hover in plot["hover"]:
            assert hover["values"] and all(v["name"] in hover["words"] for v in hover["values"])
    images = [p.get("image") for p in (*touched["heat"].values(), touched["report"]["H1,H2"])]
    assert images == ["data:image/png;base64,"] * 2


def assert_shown(value, number, error):
    assert value["p"] == pytest.approx(number, rel=1e-9) and value["error"] >= error


def test_densities_have_the_numbers_of_every_route(touched, outcome):
    plots = {plot["id"]: plot for plot in live_record(outcome)["plots"]}
    for hover in touched["report"]["q2"]["hover"]:
        for value, density in zip(
            hover["values"], outcome.curves[0].of("q2").values(), strict=True
        ):
            p, error = density.at(np.array([value["x"]]))
            assert_shown(value, p[0], error[0])
    for name in ("q2,p2", "H1,H2"):
        densities = outcome.curves[0].of(name)
        x, y = plots[name]["x"], plots[name]["y"]
        for hover, k in zip(touched["report"][name]["hover"], (30, 31), strict=True):
            assert list(hover["place"].values()) == [x[k], y[k]]
            at = [np.array([hover["place"][axis]]) for axis in "xy"]
            assert len(hover["values"]) == len(densities) == hover["words"].count("±") >= 1
            for value, density in zip(hover["values"], densities.values(), strict=True):
                p, error = density.at(*at)
                assert_shown(value, p[0], error[0])
                # Another point has another number: the comparison can fail.
                assert value["p"] != pytest.approx(density(at[0], at[1] + 0.05)[0], rel=1e-4)


def test_answers_in_time_have_the_numbers_of_every_route(touched, outcome):
    (passages,), (transients,) = outcome.curves[0].passages, outcome.curves[0].transients
    given = {g.route.words: g.answer for g in passages.given}
    for k, hover in enumerate(touched["report"]["passage_1"]["hover"]):
        assert hover["place"]["x"] == passages.question.times[k]
        for value in hover["values"]:
            answer = given[value["name"]]
            assert_shown(value, answer.survival[k], answer.survival_error[k])
    hover = touched["report"]["transient_1"]["hover"][0]
    first = f"t = {transients.question.times[0]:g}"
    assert {v["curve"] for v in hover["values"]} == {first}  # others on demand
    given = {g.route.words: g.answer for g in transients.given}
    for value in hover["values"]:
        answer, i = given[value["name"]], int(np.argmin(np.abs(transients.points - value["x"])))
        assert_shown(value, answer.values[0, i], answer.errors[0, i])


def test_sweeps_have_the_numbers_of_every_method(touched, sweeps):
    _, (one, two) = sweeps
    for k in range(2):
        x, plot = one.axes[0].values, touched["line"][f"picture_{k}"]
        left, *_, right = plot["ends"]
        assert left < x[0] and right > x[-1]  # markers are whole
        for i, hover in enumerate(plot["hover"], 1):
            assert hover["place"]["x"] == x[i]
            names = [v["name"] for v in hover["values"]]
            assert names == [reader_words(m) for m in one.methods]
            for m, value in enumerate(hover["values"]):
                assert_shown(value, one.field("value")[k, m, i], one.field("error")[k, m, i])
    for i, hover in enumerate(touched["heat"]["picture_0"]["hover"], 1):
        values = {v["name"]: v for v in hover["values"]}
        assert len(values) == len(two.quantities) * len(two.methods)
        for k, quantity in enumerate(two.quantities):
            for m, method in enumerate(two.methods):
                value, at = values[f"{quantity} by {reader_words(method)}"], (k, m, i, i)
                assert_shown(value, two.field("value")[at], two.field("error")[at])


def test_a_map_of_regimes_says_which_theory_is_nearer(touched):
    hover = touched["regime"]["picture_0"]["hover"][0]
    values = {v["name"]: v for v in hover["values"]}
    assert values["nearer to the full system"]["words"] == "energy averaging"
    assert values["L₁, modal averaging"]["p"] > 0.1 > values["L₁, energy averaging"]["p"]
    assert "nearer to the full system: energy averaging" in hover["words"]
    assert values["clearance over rms"]["p"] > 0.0
    assert touched["regime"]["picture_0"]["said"] == "Dotted: clearance = 2 rms."


def test_the_diagram_of_cost_says_method_setting_error_and_time(touched, study):
    first, second = touched["cost"]["picture_0"]["hover"]
    (value,) = first["values"]
    point = study.routes[0].points[1]
    assert (value["name"], value["x"], value["p"]) == ("coarse", point.seconds, point.error)
    assert "setting 1, states 2.0e-05" in value["note"] and value["note"] in first["words"]
    assert "processor time" in first["words"] and "L₁ error = 1.0000e−5" in first["words"]
    (value,) = second["values"]  # to the right; above the first curve is no other
    point = study.routes[0].points[2]
    assert (value["x"], value["p"]) == (point.seconds, point.error)
    (plot,) = live_plots(study.page().panels, "picture")
    assert [s["name"] for s in plot["series"]] == ["coarse", "energy averaging, finite elements"]


SIZES = """
const page = document.documentElement, box = e => e.getBoundingClientRect();
for (const d of document.querySelectorAll("details")) d.open = true;
const seen = e => e.checkVisibility({visibilityProperty: true}) && box(e).height > 0;
const count = words => [...document.querySelectorAll(words)].filter(e => box(e).width).length;
const own = e => e.closest("svg, .wide, pre");  // these clip or scroll by themselves
const cut = e => e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).display !== "inline" &&
  e.clientWidth || box(e).right > page.clientWidth + 1;
const scale = e => Math.hypot(e.getScreenCTM().a, e.getScreenCTM().b);
return {live: count(".live"), drawn: count("figure:not(.live)"),
  still: document.querySelectorAll(".still").length,
  controls: [...document.querySelectorAll("#touch > *, input")].filter(seen).length,
  beyond: [...document.querySelectorAll("body *")].filter(e => !own(e) && cut(e)).map(
    e => e.outerHTML.slice(0, 90)),
  letters: Math.min(99, ...[...document.querySelectorAll("svg text")].filter(seen).map(
    e => parseFloat(getComputedStyle(e).fontSize) * scale(e))),
  images: [...document.querySelectorAll("figure img")].filter(seen).map(e => e.naturalWidth),
  empty: [...document.querySelectorAll("h2[id]")].filter(h => seen(h) &&
    !h.parentElement.querySelector(`#${h.id} ~ :not([hidden])`)?.textContent.trim()).length,
  cut: [...document.querySelectorAll("table")].map(e => e.parentElement)
    .filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.textContent.slice(0, 90))};
"""
LETTERS = 9.0, 8.5
"""Least height in pixels of letters in pictures as drawn, of a report and of a study."""


def test_no_window_cuts_a_page_and_paper_and_no_script_have_the_pictures(browser, pages):
    def sizes(url, **how):
        browser.open(url, **how)
        return browser.result(SIZES)

    for name, url in pages.items():
        screen, wide = (sizes(url, width=width, height=844) for width in (390, 1280))
        bare = sizes(url, width=390, script=False)
        for one in (screen, wide, bare):
            assert one["beyond"] == [] and one["letters"] >= LETTERS[name != "report"], name
            assert one is bare or (one["live"] > 0 and one["controls"] > 0), name
            assert one is bare or one["cut"] == [], name
        paper = sizes(url, width=700, paper=True)
        assert paper["controls"] == 0 < paper["live"] and paper["drawn"] == screen["drawn"], name
        assert bare["live"] == bare["still"] == bare["controls"] == 0
        assert bare["drawn"] == screen["drawn"] + screen["still"], name
        assert min(bare["images"]) > 200 and bare["empty"] == 0, name


def test_what_there_is_not_is_null_in_the_data_and_empty_in_the_picture(sweeps):
    _, (_, two) = sweeps
    values = np.array([[1.0, np.nan, 2.0], [3.0, 4.0, 5.0], [6.0, 7.0, 8.0]])
    fields = [Field("a", *two.axes, values, values, logarithmic=True, limits=(1.0, 8.0))]
    (plot,) = live_plots(fields, "picture")
    assert plot["fields"][0]["z"][:3] == [1.0, None, 2.0]
    assert plot["fields"][0]["error"][:3] == [1.0, None, 2.0]
    assert study_figure(fields).axes
    (plot,) = live_plots([Panel("t", "x", "y", [Curve("a", [1.0, 2.0], [np.nan, 0.0])])], "p")
    assert plot["series"][0]["y"] == [None, pytest.approx(EPS)]
    assert "NaN" not in json.dumps([plot["series"][0]["y"]])


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_without_script_a_study_shows_its_picture_on_light_ground(browser, pages, dark):
    for name in ("cost", "regime"):
        browser.open(pages[name], width=1280, script=False, dark=dark)
        ground = browser.result(
            "return getComputedStyle(document.querySelector('figure img')).backgroundColor;"
        )
        assert (ground == "rgb(253, 253, 251)") == dark


def test_numbers_of_an_axis_stand_apart_on_a_telephone(browser, pages):
    browser.open(pages["cost"], width=390, height=844)
    boxes = browser.result(
        """return [...document.querySelectorAll(".live .pair text")].map(
          e => e.getBoundingClientRect()).map(r => [r.left, r.right, r.top, r.bottom]);"""
    )
    assert len(boxes) > 8
    for (left, right, top, bottom), other in combinations(boxes, 2):
        assert right <= other[0] or other[1] <= left or bottom <= other[2] or other[3] <= top


def test_columns_of_words_stand_at_the_left_and_parameters_have_all_their_digits(browser, pages):
    columns = """return [...document.querySelectorAll("table")].map(t => Object.fromEntries(
      [...t.querySelectorAll("th")].map((h, k) => [h.textContent,
        [h, t.querySelectorAll("td")[k]].map(e => getComputedStyle(e).textAlign)])));"""
    browser.open(pages["cost"], width=1280)
    for head, side in (item for table in browser.result(columns) for item in table.items()):
        words = head in ("equation", "route", "settings", "priced by", "above", "below")
        assert side == ["left", "left"] if words else ["right", "right"]
    browser.open(pages["units"], width=1280)
    cells = browser.result("""
      return document.querySelector("tbody tr").querySelectorAll("td").values()
        .map(e => [e.textContent, getComputedStyle(e).textAlign]).toArray();""")
    assert cells[:2] == [["0.3", "right"], ["0.123456", "right"]]
    assert [align for _, align in cells[2:4]] == ["left", "left"]
