"""The page as it is seen: both schemes, a telephone, without script, on paper."""

import pytest

from cases.show.digest import digest_of
from cases.show.report import write_report

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
