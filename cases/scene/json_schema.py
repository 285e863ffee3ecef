"""The JSON Schema of a scene, for editors: made from the schema that reads scenes."""

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
