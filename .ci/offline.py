"""Refuse pages that load anything from a network, or link to a file or anchor that is not there."""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """What a page loads, where it links to, and its anchors."""

    def __init__(self, text: str) -> None:
        """Read the page."""
        super().__init__()
        self.loads: list[str] = []
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        """Note the references of a tag."""
        of = {key: value or "" for key, value in attributes}
        self.anchors |= {of[key] for key in ("id", "name") if key in of}
        if tag == "a":
            self.links += [of["href"]] if "href" in of else []
        elif of.get("rel") not in ("canonical", "index", "search", "next", "prev", "author"):
            self.loads += [of[key] for key in ("src", "href", "data", "srcset") if key in of]


def problems(site: Path) -> list[str]:
    """Return in words what a reader without a network misses on the pages of ``site``."""
    paths = [path.resolve() for path in site.rglob("*.html") if "_static" not in path.parts]
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in paths}
    found = [] if pages else [f"{site}: no page"]
    for path, page in pages.items():
        for reference in page.loads + page.links:
            parts = urlsplit(reference)
            if parts.scheme or parts.netloc:
                if reference in page.loads and parts.scheme != "data":
                    found.append(f"{path.name}: loads {reference}")
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            anchor = unquote(parts.fragment)
            if not target.exists():
                found.append(f"{path.name}: {reference} is not there")
            elif anchor and target in pages and anchor not in pages[target].anchors:
                found.append(f"{path.name}: {reference} has no such anchor")
    for sheet in site.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8")
        if "url(http" in text or "url(//" in text or '@import url("http' in text:
            found.append(f"{sheet.name}: loads from a network")
    return found


if __name__ == "__main__":
    words = problems(Path(sys.argv[1]))
    print("\n".join(words[:50]) or "nothing from a network, no dead link")
    sys.exit(bool(words))
