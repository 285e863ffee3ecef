"""Maps, answers in time and pages of studies in a browser: numbers, hover, keyboard, toggles."""

import json

import numpy as np
import pytest

import fpk as face
from cases.compare.routes import method_for
from cases.compare.stationary import run_scene
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
def outcome(scene_text, tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "any.toml"
    path.write_text(scene_text.replace('["q2", "H"]', '["q2,p2", "H1,H2"]') + QUESTIONS)
    methods = [method_for("nonintegrable"), method_for("integrable", "closed-form")]
    return run_scene(load_scene(str(path)), methods)


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


def with_units(path, scene):
    path.write_text(scene.text + '\n[units]\nlength = "mm"\nmass = "kg"\ntime = "ms"\n', "utf-8")
    return path


@pytest.fixture(scope="module")
def pages(outcome, sweeps, study, tmp_path_factory):
    """Addresses of the pages as they are written, by name."""
    folder = tmp_path_factory.mktemp("pages")
    write_report(outcome, digest_of(outcome), folder)
    found = {"report": (folder / "report.html").as_uri()}
    scene, (one, two) = sweeps
    regime = build_map(scene, ["contact.clearance=0.5,1", "contact.stiffness=1,10,100"])
    reader_words = load_scene(str(with_units(folder / "named.toml", scene)))
    grid = {"contact[1].clearance": [0.3, 0.5, 1.0], "system.noise_intensity": [0.123456, 0.5, 1.0]}
    units = face.sweep(reader_words, grid, ["rms(q2)", "force_in_contact(1)"]).page()
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
    assert count == {"report": 4, "line": 2, "heat": 1, "regime": 1, "cost": 1, "units": 1}
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


def test_maps_of_joint_densities_have_the_numbers_of_every_route(touched, outcome):
    plots = {plot["id"]: plot for plot in live_record(outcome)["plots"]}
    for name in ("q2,p2", "H1,H2"):
        densities = outcome.curves[0].of(name)
        first, second = touched["report"][name]["hover"]
        x, y = plots[name]["x"], plots[name]["y"]
        assert list(first["place"].values()) == [x[30], y[30]]
        assert list(second["place"].values()) == [x[31], y[31]]
        for hover in (first, second):
            at = [np.array([hover["place"][axis]]) for axis in "xy"]
            assert len(hover["values"]) == len(densities) >= 1
            for value, density in zip(hover["values"], densities.values(), strict=True):
                p, error = density.at(*at)
                assert value["p"] == pytest.approx(p[0], rel=1e-9) and value["error"] >= error[0]
                # Another point has another number: the comparison can fail.
                assert value["p"] != pytest.approx(density(at[0], at[1] + 0.05)[0], rel=1e-4)
            assert hover["words"].count("±") == len(densities)


def test_answers_in_time_have_the_numbers_of_every_route(touched, outcome):
    (passages,), (transients,) = outcome.curves[0].passages, outcome.curves[0].transients
    given = {g.route.words: g.answer for g in passages.given}
    for hover, k in zip(touched["report"]["passage_1"]["hover"], (0, 1), strict=True):
        assert hover["place"]["x"] == passages.question.times[k]
        for value in hover["values"]:
            answer = given[value["name"]]
            assert value["p"] == pytest.approx(answer.survival[k], rel=1e-9)
            assert value["error"] >= answer.survival_error[k]
    hover = touched["report"]["transient_1"]["hover"][0]
    times = [f"t = {t:g}" for t in transients.question.times]
    assert {v["curve"] for v in hover["values"]} == {times[0]}  # others on demand
    given = {g.route.words: g.answer for g in transients.given}
    for value in hover["values"]:
        answer, k = given[value["name"]], times.index(value["curve"])
        i = int(np.argmin(np.abs(transients.points - value["x"])))
        assert value["p"] == pytest.approx(answer.values[k, i], rel=1e-9)
        assert value["error"] >= answer.errors[k, i]


def test_sweeps_have_the_numbers_of_every_method(touched, sweeps):
    _, (one, two) = sweeps
    for k in range(2):
        left, *_, right = touched["line"][f"picture_{k}"]["ends"]
        assert left < one.axes[0].values[0] and right > one.axes[0].values[-1]  # markers are whole
        for hover, i in zip(touched["line"][f"picture_{k}"]["hover"], (1, 2), strict=True):
            assert hover["place"]["x"] == one.axes[0].values[i]
            names = [v["name"].partition(" (covers ")[0] for v in hover["values"]]
            assert names == [reader_words(m) for m in one.methods]
            for m, value in enumerate(hover["values"]):
                assert value["p"] == pytest.approx(one.field("value")[k, m, i], rel=1e-9)
                assert value["error"] >= one.field("error")[k, m, i]
    for hover, place in zip(touched["heat"]["picture_0"]["hover"], ((1, 1), (2, 2)), strict=True):
        values = {v["name"]: v for v in hover["values"]}
        assert len(values) == len(two.quantities) * len(two.methods)
        for k, quantity in enumerate(two.quantities):
            for m, method in enumerate(two.methods):
                value, at = values[f"{quantity} by {reader_words(method)}"], (k, m, *place)
                assert value["p"] == pytest.approx(two.field("value")[at], rel=1e-9)
                assert value["error"] >= two.field("error")[at]


def test_a_map_of_regimes_says_which_theory_is_nearer(touched):
    hover = touched["regime"]["picture_0"]["hover"][0]
    values = {v["name"]: v for v in hover["values"]}
    assert values["nearer to the full system"]["words"] == "energy averaging"
    assert values["L₁, modal averaging"]["p"] > 0.1 > values["L₁, energy averaging"]["p"]
    assert "nearer to the full system: energy averaging" in hover["words"]
    assert values["clearance over rms"]["p"] > 0.0
    assert touched["regime"]["picture_0"]["said"] == "Dotted: clearance = 2 rms."


def test_legends_of_studies_name_theories_in_words(study):
    (plot,) = live_plots(study.page().panels, "picture")
    assert [s["name"] for s in plot["series"]] == ["coarse", "energy averaging, finite elements"]


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


SIZES = """
const page = document.documentElement, box = e => e.getBoundingClientRect();
for (const d of document.querySelectorAll("details")) d.open = true;
const count = words => [...document.querySelectorAll(words)].filter(e => box(e).width).length;
return {live: count(".live"), drawn: count("figure:not(.live)"),
  still: document.querySelectorAll(".still").length, touch: count("#touch > *"),
  beyond: [...document.querySelectorAll("body *")].filter(e => !e.closest("svg, .wide") &&
    box(e).right > page.clientWidth + 1).map(e => e.outerHTML.slice(0, 90)),
  small: [...document.querySelectorAll(".live svg text")].map(box)
    .filter(r => r.height > 0 && Math.min(r.height, r.width) < 6).length,
  cut: [...document.querySelectorAll("table")].map(e => e.parentElement)
    .filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.textContent.slice(0, 90))};
"""


def test_no_page_is_wider_than_a_telephone_and_paper_and_no_script_have_the_pictures(
    browser, pages
):
    def sizes(url, **how):
        browser.open(url, **how)
        return browser.result(SIZES)

    for name, url in pages.items():
        screen, wide = (sizes(url, width=width) for width in (390, 1280))
        for one in (screen, wide):
            assert one["beyond"] == [] and one["small"] == 0, name
            assert one["live"] > 0 and one["touch"] > 0 and one["cut"] == [], name
        paper = sizes(url, width=700, paper=True)
        assert paper["touch"] == 0 < paper["live"] and paper["drawn"] == screen["drawn"], name
        bare = sizes(url, width=390, script=False)
        assert bare["live"] == bare["still"] == 0
        assert bare["drawn"] == screen["drawn"] + screen["still"], name


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
        (picture,) = browser.result(
            """return [...document.querySelectorAll("figure img")].map(
              e => [e.naturalWidth, getComputedStyle(e).backgroundColor]);"""
        )
        assert picture[0] > 300 and (picture[1] == "rgb(253, 253, 251)") == dark


def test_a_telephone_has_fewer_numbers_on_an_axis_of_powers(browser, pages):
    browser.open(pages["cost"], width=390, height=844)
    boxes = browser.result(
        """return [...document.querySelectorAll(".live .pair text")].map(
          e => e.getBoundingClientRect()).map(r => [r.left, r.right, r.top, r.bottom]);"""
    )
    assert len(boxes) > 8
    for k, (left, right, top, bottom) in enumerate(boxes):
        for l, r, t, b in boxes[:k]:  # noqa: E741
            assert right <= l or r <= left or bottom <= t or b <= top


def test_columns_of_words_stand_at_the_left(browser, pages):
    browser.open(pages["cost"], width=1280)
    sides = browser.result(
        """return [...document.querySelectorAll("table")].map(t => Object.fromEntries(
          [...t.querySelectorAll("th")].map((h, k) => [h.textContent,
            [h, t.querySelectorAll("td")[k]].map(e => getComputedStyle(e).textAlign)])));"""
    )
    for table in sides:
        for head, side in table.items():
            words = head in ("equation", "route", "settings", "priced by", "above", "below")
            assert side == ["left", "left"] if words else ["right", "right"]


def test_parameters_of_a_page_have_all_their_digits_and_text_stands_at_the_left(browser, pages):
    browser.open(pages["units"], width=1280)
    row = browser.result("""
      return document.querySelector("tbody tr").querySelectorAll("td").values()
        .map(e => [e.textContent, getComputedStyle(e).textAlign]).toArray();""")
    assert row[:2] == [["0.3", "right"], ["0.123456", "right"]]
    assert [align for _, align in row[2:4]] == ["left", "left"]
