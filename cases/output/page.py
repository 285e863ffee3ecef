"""Style and scripts that stand inside a page, and the policy that allows no others."""

from base64 import b64encode
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

from markupsafe import Markup

from cases.output.pictures.style import COLOURS, DARK
from cases.output.records import Record

TEMPLATES = Path(__file__).parent / "templates"


def page_record(scripts: Sequence[str] = ()) -> Record:
    """Return ``style``, ``script`` and ``policy`` of ``page.html``; ``scripts`` are file names.

    The policy is the content security policy of the page: of styles and scripts it has the sources.
    """
    style = Markup("\n").join((_source("report.css"), _dark_curves()))
    script = Markup("\n").join(map(_source, scripts))
    policy = {"style": _hash(style), "script": _hash(script) if scripts else "'none'"}
    return {"style": style, "script": script, "policy": policy}


def _source(name: str) -> Markup:
    """The text of a file in ``templates``, which the page takes over without escaping."""
    return Markup((TEMPLATES / name).read_text(encoding="utf-8").strip())


def _dark_curves() -> Markup:
    """Rules by which curves take their colours on a dark page; those of an attribute yield."""
    rules = "".join(
        f'[{key}="{light}"]{{{key}:{dark}}}'
        for light, dark in zip(COLOURS, DARK, strict=True)
        for key in ("fill", "stroke")
    )
    return Markup(f"@media screen and (prefers-color-scheme: dark) {{ {rules} }}")


def _hash(text: str) -> Markup:
    """The source expression 'sha256-…' by which a content security policy allows a text."""
    digest = sha256(text.encode()).digest()
    return Markup(f"'sha256-{b64encode(digest).decode()}'")
