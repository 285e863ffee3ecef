"""Every key of a scene as a table: ``python docs/key_table.py docs/scene.md`` writes it anew.

The table, made from the JSON Schema of a scene, stands between two marks in the document.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cases.scene.json_schema import scene_schema

MARKS = "<!-- keys: by python docs/key_table.py -->", "<!-- end of keys -->"


def key_table() -> str:
    """Return the table: a row for each key with its type, whether it is needed, and what it is."""
    rows = [["key", "type", "needed", "meaning"], ["---"] * 4]
    rows += [[f"`{key}`", *cells] for key, *cells in _rows("", scene_schema())]
    return "\n".join(
        f"| {' | '.join(cell.replace('|', '&#124;') for cell in row)} |" for row in rows
    )


def with_table(document: str) -> str:
    """Return the document with the table between ``MARKS``; raises ``ValueError`` without these."""
    head, mark, rest = document.partition(MARKS[0])
    _, end, tail = rest.partition(MARKS[1])
    if not (mark and end):
        raise ValueError("the document has no marks for the table")
    return f"{head}{mark}\n\n{key_table()}\n\n{end}{tail}"


def _rows(prefix: str, schema: dict[str, Any]) -> Iterator[tuple[str, str, str, str]]:
    for key, own in schema["properties"].items():
        inner = own.get("items", {}) if own.get("type") == "array" else own
        path = f"{prefix}{key}"
        if "properties" in inner:
            yield from _rows(f"{path}{'[]' if inner is not own else ''}.", inner)
            continue
        needed = "yes" if key in schema.get("required", ()) else ""
        yield path, _words(own), needed, own.get("description", "")


def _words(schema: dict[str, Any]) -> str:
    """The type of a value in words."""
    if "anyOf" in schema:
        return " or ".join(map(_words, schema["anyOf"]))
    if "enum" in schema:
        return ", ".join(f'"{word}"' for word in schema["enum"])
    match schema["type"]:
        case "array":
            items = _words(schema["items"])
            return {"numbers": "matrix", "number": "numbers"}.get(items, f"list of {items}")
        case "object":
            by = schema["propertyNames"]["description"]
            return f"table, {_words(schema['additionalProperties'])} by {by}"
        case other:
            return {"integer": "whole number", "string": "text"}.get(other, str(other))


if __name__ == "__main__":
    page = Path(sys.argv[1])
    page.write_text(with_table(page.read_text(encoding="utf-8")), encoding="utf-8")
