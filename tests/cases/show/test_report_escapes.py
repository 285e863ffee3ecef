"""Text of a scene is text in the report and its pictures: for a parser and for a browser."""

import re
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from xml.etree import ElementTree

import pytest

from cases.scene.scene import load_scene
from cases.show.digest import digest_of
from cases.show.page import PageStyle
from cases.show.report import live_record, report_html, write_report
from cases.show.study_page import Page

PAYLOADS = [
    "<script>document.title='pwned'</script>",
    "<img src=x onerror=\"document.title='pwned'\">",
    "</title></pre></svg></style><svg/onload=document.title='pwned'>",
    '" onmouseover="document.title=1" x="',
    "' onclick='document.title=1' {{ 7*7 }} {% raw %} ]]> --> <!-- &lt; &#60;b>",
]


class Structure(HTMLParser):
    """Tags with their attributes' names, and all text between them."""

    def __init__(self, page):
        super().__init__(convert_charrefs=True)
        self.tags, self.texts = [], []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, *(name for name, _ in attrs)))

    def handle_data(self, data):
        self.texts.append(data)


@pytest.fixture(scope="module")
def named(solved, scene_text):
    """The outcome of two curves of which everything that a scene may say is ``words``."""

    def solve(words):
        quoted = f"'''{words}'''"
        text = scene_text.replace(', "H"]', "]")
        text = text.replace('"A scene"', quoted).replace('"tests"', quoted)
        found = solved(
            f"# {words}\n{text}", "nonintegrable/closed-form", name=words.replace("/", "")[:60]
        )
        curves = tuple(replace(c, label=f"{words} {i}") for i, c in enumerate(2 * found.curves))
        return replace(found, curves=curves)

    return solve


def elements(outcome):
    live = live_record(outcome)
    return Structure(report_html(outcome.scene, digest_of(outcome), [], live=live))


@pytest.mark.parametrize("words", PAYLOADS)
def test_a_scene_adds_text_and_no_element_to_the_page_and_its_pictures(words, named, tmp_path):
    outcome = named(words)
    page, plain = elements(outcome), elements(named("plain"))
    assert page.tags == plain.tags and len(page.tags) > 100
    assert sum(words in text for text in page.texts) >= 4  # title twice, source, scene file
    assert not any(name.startswith("on") for tag in page.tags for name in tag[1:])
    scripts = [tag for tag in page.tags if tag[0] == "script"]
    assert scripts == [("script", "type", "id"), ("script",)]  # the data and the page's own
    for path in write_report(outcome, digest_of(outcome), tmp_path):
        if path.suffix == ".svg":
            tree = ElementTree.parse(path)
            tags = {node.tag.rpartition("}")[2] for node in tree.iter()}
            assert {"svg", "path"} <= tags and not tags & {"script", "img", "title"}
            assert not any(a.startswith("on") for node in tree.iter() for a in node.attrib)


@pytest.mark.slow
def test_a_browser_shows_the_text_and_runs_nothing(browser, named, tmp_path):
    words = PAYLOADS[1] + PAYLOADS[0]
    outcome = named(words)
    write_report(outcome, digest_of(outcome), tmp_path)
    browser.open((tmp_path / "report.html").as_uri(), width=1280)
    shown = Structure(browser.value("document.documentElement.outerHTML"))
    assert shown.texts.count("pwned") == 0 and words in shown.texts
    names = [tag[0] for tag in shown.tags]
    assert names.count("script") == 2
    assert {tag[1:] for tag in shown.tags if tag[0] == "img"} == {("src", "alt")}
    # The browser does run what is not escaped; the page's policy stops it even then.
    unescaped = unescape((tmp_path / "report.html").read_text(encoding="utf-8"))
    policy = unescaped.partition('<meta http-equiv="Content-Security-Policy"')[2].partition(">")[0]
    assert "default-src 'none'" in policy
    for text, title in ((unescaped, False), (unescaped.replace(policy, ""), True)):
        (tmp_path / "unescaped.html").write_text(text, encoding="utf-8")
        browser.open((tmp_path / "unescaped.html").as_uri(), width=1280)
        assert (browser.value("document.title") == "pwned") is title


@pytest.mark.parametrize("words", [*PAYLOADS, "[a](javascript:b) *c* _d_ `e` | $f$ \\ #"])
def test_the_title_of_a_page_is_text_in_markdown(words, written, scene_text):
    scene = load_scene(written(scene_text.replace('"A scene"', f"'''{words}'''")))
    page = Page("regime", scene, f"Map: {scene.title}", [], [])
    first, _, rest = page.text().partition("\n")
    assert first.startswith("# Map: ") and rest.strip() == ""
    title = first.removeprefix("# ")
    assert re.sub(r"\\(.)", r"\1", title) == page.title
    assert not re.search(r"[`*_\[\]<>&|$]", re.sub(r"\\.", "", title))


def test_names_of_columns_are_strings_of_the_style():
    style = PageStyle()
    names = [*PAYLOADS, "time [s]", "|z|", "a\\", "", "p(q₂)\n}", "9 lives"]
    assert style.table(names) == style.table(names) == "t0" != style.table(names[1:])
    rules = style.text.partition("44rem) { .t0")[2]
    # Nothing ends a string but its own mark, for which special characters stand as numbers.
    strings = re.findall(r'content:"([^"]*)"', rules)
    shown = [re.sub(r"\\([0-9a-f]+) ", lambda m: chr(int(m[1], 16)), s) for s in strings]
    assert shown == [*names, *names[1:]]
    assert "<" not in rules and not any(set(s) & set("{};'\n") for s in strings)
