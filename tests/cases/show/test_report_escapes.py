"""Text of a scene is text in the report and its pictures: for a parser and for a browser."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import pytest

from cases.compare.routes import method_for
from cases.compare.stationary import run_scene
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


def _outcome(folder, scene_text, *, words, label):
    path = folder / f"{words.replace('/', '')[:60]}.toml"
    quoted = "'''" + words + "'''"
    text = scene_text.replace('"A scene"', quoted).replace('"tests"', quoted)
    path.write_text(f"# {words}\n{text}")
    found = run_scene(load_scene(str(path)), [method_for("nonintegrable", "closed-form")])
    curves = tuple(replace(c, label=f"{label} {i}") for i, c in enumerate(2 * found.curves))
    return replace(found, curves=curves)


def _elements(outcome):
    live = live_record(outcome)
    return Structure(report_html(outcome.scene, digest_of(outcome), [], live=live))


@pytest.fixture(scope="module")
def plain(scene_text, tmp_path_factory):
    folder = tmp_path_factory.mktemp("plain")
    return _elements(_outcome(folder, scene_text, words="plain", label="B"))


@pytest.mark.parametrize("words", PAYLOADS)
def test_a_scene_adds_text_and_no_element(words, plain, scene_text, tmp_path):
    outcome = _outcome(tmp_path, scene_text, words=words, label=words)
    page = _elements(outcome)
    assert page.tags == plain.tags and len(page.tags) > 100
    assert sum(words in text for text in page.texts) >= 4  # title twice, source, scene file
    assert not any(name.startswith("on") for tag in page.tags for name in tag[1:])
    scripts = [tag for tag in page.tags if tag[0] == "script"]
    assert scripts == [("script", "type", "id"), ("script",)]  # the data and the page's own


def test_text_in_pictures_is_drawn_and_no_element(scene_text, tmp_path):
    for k, words in enumerate((PAYLOADS[0], PAYLOADS[2])):
        folder = tmp_path / str(k)
        folder.mkdir()
        outcome = _outcome(folder, scene_text.replace(', "H"]', "]"), words=words, label=words)
        for path in write_report(outcome, digest_of(outcome), folder):
            if path.suffix == ".svg":
                tree = ElementTree.parse(path)
                tags = {node.tag.rpartition("}")[2] for node in tree.iter()}
                assert {"svg", "path"} <= tags and not tags & {"script", "img", "title"}
                assert not any(a.startswith("on") for node in tree.iter() for a in node.attrib)
        assert "pwned" not in "".join(str(t) for t in Structure(_page(folder)).tags)


@pytest.mark.slow
def test_a_browser_shows_the_text_and_runs_nothing(browser, scene_text, tmp_path):
    words = PAYLOADS[1] + PAYLOADS[0]
    outcome = _outcome(tmp_path, scene_text.replace(', "H"]', "]"), words=words, label=words)
    write_report(outcome, digest_of(outcome), tmp_path)
    browser.open((tmp_path / "report.html").as_uri(), width=1280)
    shown = Structure(browser.value("document.documentElement.outerHTML"))
    assert shown.texts.count("pwned") == 0 and words in shown.texts
    names = [tag[0] for tag in shown.tags]
    assert names.count("script") == 2
    assert {tag[1:] for tag in shown.tags if tag[0] == "img"} == {("src", "alt")}
    # The browser does run what is not escaped; the page's policy stops it even then.
    unescaped = _page(tmp_path).replace("&lt;", "<").replace("&gt;", ">")
    unescaped = unescaped.replace("&#34;", '"').replace("&#39;", "'")
    policy = unescaped.partition('<meta http-equiv="Content-Security-Policy"')[2].partition(">")[0]
    assert "default-src 'none'" in policy
    for text, title in ((unescaped, False), (unescaped.replace(policy, ""), True)):
        (tmp_path / "unescaped.html").write_text(text, encoding="utf-8")
        browser.open((tmp_path / "unescaped.html").as_uri(), width=1280)
        assert (browser.value("document.title") == "pwned") is title


def _page(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("words", [*PAYLOADS, "[a](javascript:b) *c* _d_ `e` | $f$ \\ #"])
def test_the_title_of_a_page_is_text_in_markdown(words, tmp_path, scene_text):
    path = tmp_path / "any.toml"
    path.write_text(scene_text.replace('"A scene"', "'''" + words + "'''"))
    scene = load_scene(str(path))
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
