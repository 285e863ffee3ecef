"""The text of a new scene, and the JSON Schema of scenes, made from the schema that reads them."""

from math import sqrt
from typing import Any

from cases.scene.schema import SCENE
from fpk.system.contact_law import LAWS

FILE = "scene.schema.json"
"""Name of the JSON Schema beside a scene, by which an editor checks and completes its keys."""
DIRECTIVE = f"#:schema ./{FILE}"
"""First line of a scene, by which Taplo and Even Better TOML find the file."""


def scene_schema() -> dict[str, Any]:
    """Return the JSON Schema: keys, types, lengths and choices of a scene.

    Conditions on several values, such as the length of a list by the number of masses, are checked
    by ``fpk check`` only.
    """
    dialect = "https://json-schema.org/draft/2020-12/schema"
    return {"$schema": dialect, "title": "Scene of vibro-fpk", **_to_json_schema(SCENE)}


def _to_json_schema(schema: Any) -> dict[str, Any]:
    """Return a ``schema`` of pydantic-core as JSON Schema, its ``metadata`` copied.

    Raises ``TypeError`` for a type that has no translation here.
    """
    own = dict(schema.get("metadata", {}))
    lengths = {"min_length": "minItems", "max_length": "maxItems"}
    keys = {"ge": "minimum", "gt": "exclusiveMinimum", **lengths}
    bounds = {name: schema[key] for key, name in keys.items() if key in schema}
    match schema["type"]:
        case "typed-dict":
            fields = schema["fields"].items()
            required = [key for key, field in fields if field["required"]]
            own["type"] = "object"
            own["properties"] = {key: _to_json_schema(field["schema"]) for key, field in fields}
            own |= {"required": required} if required else {}
            own["additionalProperties"] = False
        case "list":
            own |= {"type": "array", "items": _to_json_schema(schema["items_schema"]), **bounds}
        case "dict":
            own |= {"type": "object", "maxProperties": schema["max_length"]}
            own["propertyNames"] = _to_json_schema(schema["keys_schema"])
            own["additionalProperties"] = _to_json_schema(schema["values_schema"])
        case "tagged-union":
            own["anyOf"] = [_to_json_schema(choice) for choice in schema["choices"].values()]
        case "literal":
            own["enum"] = schema["expected"]
        case "function-after":
            own = {**_to_json_schema(schema["schema"]), **own}
        case "str":
            own |= {"type": "string"}
            own |= {"pattern": schema["pattern"]} if "pattern" in schema else {}
            own |= {"maxLength": schema["max_length"]} if "max_length" in schema else {}
        case "int" | "float" as kind:
            own |= {"type": {"int": "integer", "float": "number"}[kind], **bounds}
        case other:
            raise TypeError(f"a schema of the type {other} has no form in JSON Schema yet")
    return own


FURTHER = """
# [vary]                                 # further curves: one key, several values
# contact.stiffness = [1.0, 100.0]

# [[passage]]                            # when is this first passed, how likely by these times?
# limit = "H=1.0"
# times = [10.0, 100.0]
"""


def scene_text(name: str, masses: int, law: str) -> str:
    """Return the TOML text of a scene titled ``name``: ``masses`` unit masses, springs of 1.

    The last mass has stops on both sides of the contact law ``law``, a key of ``LAWS``. The
    clearance is the rms displacement of the last mass without stops at the mean temperature
    Σ D/Σ c of the chain, √(masses · temperature).
    """
    # c_i and D_i of Fig. 6 alternate: their ratios differ, condition (8) does not hold.
    alternating = (0.08, 0.04), (0.01, 0.02)
    damping, noise = ([values[i % 2] for i in range(masses)] for values in alternating)
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
        ("stiffness = 10.0", "force at an overlap of 1"),
        (f"clearance = {clearance}", "about the rms displacement without stops"),
        ("", ""),
        ("[observe]", ""),
        (f'densities = ["q{masses}", "H"]', 'q1.., p1.., H, H1.., or a pair "q1,p1"'),
        (f"exceedance = {{ q{masses} = [{2 * clearance:.2g}] }}", "levels a of P(X > a)"),
    ]
    lines = [f"{line:40} # {words}" if words else line for line, words in commented]
    head = [DIRECTIVE, f'title  = "{name}"', 'source = "where the values come from"', ""]
    return "\n".join([*head, *lines, FURTHER])
