"""The JSON Schema of a scene, for editors, and every key as a table in Markdown.

Both are made from the schema that reads scenes. ``python -m cases.scene.json_schema docs/scene.md``
writes the table between its two marks anew.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cases.scene.schema import SCENE

DIALECT = "https://json-schema.org/draft/2020-12/schema"
FILE = "scene.schema.json"
"""Name of the file beside a scene that an editor reads."""
DIRECTIVE = f"#:schema ./{FILE}"
"""First line of a scene, by which Taplo and Even Better TOML find the file."""

BOUNDS = {
    "ge": "minimum",
    "gt": "exclusiveMinimum",
    "min_length": "minItems",
    "max_length": "maxItems",
}

MARKS = "<!-- keys: by python -m cases.scene.json_schema -->", "<!-- end of keys -->"
"""Lines between which the table stands in a document."""


def scene_schema() -> dict[str, Any]:
    """Return the JSON Schema: keys, types, lengths and choices of a scene.

    What depends on several values, such as the length of a list for so many masses, is checked by
    ``fpk check`` only.
    """
    return {"$schema": DIALECT, "title": "Scene of vibro-fpk", **_converted(SCENE)}


def _converted(schema: Any) -> dict[str, Any]:
    """A schema of pydantic-core in JSON Schema; ``metadata`` of it is taken as it stands."""
    own = dict(schema.get("metadata", {}))
    bounds = {BOUNDS[key]: schema[key] for key in BOUNDS if key in schema}
    match schema["type"]:
        case "typed-dict":
            fields = schema["fields"].items()
            required = [key for key, field in fields if field["required"]]
            own["type"] = "object"
            own["properties"] = {key: _converted(field["schema"]) for key, field in fields}
            own |= {"required": required} if required else {}
            own["additionalProperties"] = False
        case "list":
            own |= {"type": "array", "items": _converted(schema["items_schema"]), **bounds}
        case "dict":
            own |= {"type": "object", "maxProperties": schema["max_length"]}
            own["propertyNames"] = _converted(schema["keys_schema"])
            own["additionalProperties"] = _converted(schema["values_schema"])
        case "tagged-union":
            own["anyOf"] = [_converted(choice) for choice in schema["choices"].values()]
        case "literal":
            own["enum"] = schema["expected"]
        case "function-after":
            own = {**_converted(schema["schema"]), **own}
        case "str":
            own |= {"type": "string"}
            own |= {"pattern": schema["pattern"]} if "pattern" in schema else {}
            own |= {"maxLength": schema["max_length"]} if "max_length" in schema else {}
        case "int" | "float" as kind:
            own |= {"type": {"int": "integer", "float": "number"}[kind], **bounds}
        case other:
            raise TypeError(f"a schema of the type {other} has no form in JSON Schema yet")
    return own


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
