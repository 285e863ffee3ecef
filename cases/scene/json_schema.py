"""The text of a new scene, the JSON Schema of a scene for editors, and every key as a table.

Schema and table are made from the schema that reads scenes. ``python -m cases.scene.json_schema
docs/scene.md`` writes the table between its two marks anew.
"""

import sys
from collections.abc import Iterator
from math import sqrt
from pathlib import Path
from typing import Any

from cases.scene.schema import SCENE
from fpk.system.contact_law import LAWS

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


DAMPING, NOISE = (0.08, 0.04), (0.01, 0.02)
"""Values of c_i and of D_i, which alternate along the chain: those of Fig. 6, whose ratios differ,
so that the compatibility condition (8) does not hold."""
STIFFNESS = 10.0
"""B of the stops: the force at an overlap of 1."""
COLUMN = 40
"""Column of the comments."""
FURTHER = """
# [vary]                                 # further curves: one key, several values
# contact.stiffness = [1.0, 100.0]

# [[passage]]                            # when is this first passed, how likely by these times?
# limit = "H=1.0"
# times = [10.0, 100.0]
"""


def scene_text(name: str, masses: int, law: str) -> str:
    """Return a commented scene of ``masses`` unit masses whose last one has stops of the ``law``.

    The clearance is the rms displacement of the last mass without stops, were all of the chain at
    one temperature Σ D/Σ c: there √(masses · temperature), the springs being of unit stiffness.
    """
    damping, noise = ([values[i % 2] for i in range(masses)] for values in (DAMPING, NOISE))
    clearance = float(f"{sqrt(masses * sum(noise) / sum(damping)):.2g}")
    ones = [1.0] * masses
    exponent = [("exponent  = 2.0", "of the law power")] if LAWS[law].exponent is None else []
    commented = [
        ("[units]", "names only: every number is in these units as it stands"),
        ('length = "m"', ""),
        ('mass   = "kg"', ""),
        ('time   = "s"', ""),
        ("", ""),
        ("[system]", "masses in a row, mass 1 nearest to the wall"),
        (f"mass            = {ones}", "m_i"),
        (f"stiffness       = {ones}", "k_i joins mass i to mass i-1, k_1 to the wall"),
        (f"damping         = {damping}", "c_i, or a full matrix"),
        (f"noise_intensity = {noise}", "D_i with E[W W'] = 2 D delta, or a full matrix"),
        ("", ""),
        ("[[contact]]", "one table a stop; none: a linear chain"),
        (f"mass      = {masses}", "counted from 1"),
        ('side      = "both"', '"left", "right" or "both"'),
        (f'law       = "{law}"', f"one of {', '.join(sorted(LAWS))}"),
        *exponent,
        (f"stiffness = {STIFFNESS}", "force at an overlap of 1"),
        (f"clearance = {clearance}", "about the rms displacement without stops"),
        ("", ""),
        ("[observe]", ""),
        (f'densities = ["q{masses}", "H"]', 'q1.., p1.., H, H1.., or a pair "q1,p1"'),
        (f"exceedance = {{ q{masses} = [{2 * clearance:.2g}] }}", "levels a of P(X > a)"),
    ]
    lines = [f"{line:{COLUMN}} # {words}" if words else line for line, words in commented]
    head = [DIRECTIVE, f'title  = "{name}"', 'source = "where the values come from"', ""]
    return "\n".join([*head, *lines, FURTHER])


if __name__ == "__main__":
    page = Path(sys.argv[1])
    page.write_text(with_table(page.read_text(encoding="utf-8")), encoding="utf-8")
