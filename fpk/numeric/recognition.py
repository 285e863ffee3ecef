"""Fingerprints of settings, by which stored results are recognised.

A fingerprint contains every field of a record, so that a new field is compared, too. Fields that
cannot change a result are excluded by name, ``less``, as "MonteCarlo.threads".
"""

import json
from collections.abc import Container, Mapping, Set
from dataclasses import fields, is_dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from types import CodeType, EllipsisType, FunctionType, MethodType
from typing import Any

import numpy as np

from fpk.numeric.errors import InvalidInput

REGISTRY = "registry"
"""Key in the metadata of a dataclass field that contains a name: the value there is a registry, a
mapping, and the registry's entry of this name is compared, not the name."""


def fingerprint(value: Any, less: Container[str] = ()) -> str:
    """Return the SHA-256 of ``canonical(value, less)`` in hexadecimal digits; raises as it does."""
    return sha256(json.dumps(canonical(value, less)).encode()).hexdigest()


def canonical(value: Any, less: Container[str] = ()) -> Any:
    """Return ``value`` as JSON data with every digit and field that a result may depend on.

    A dataclass contributes its name and its init fields, except the names "Class.field" in
    ``less``, at any depth. A function contributes its name, code, defaults, closure, and the
    numbers, strings and arrays among the globals it uses, but only the names of the functions it
    calls. Equal values may give different data: 1 is not 1.0. Raises ``InvalidInput`` for an object
    of any kind but these, JSON values, arrays, mappings, sets, bytes, paths, complex numbers,
    types, methods, NumPy's ufuncs, partial functions and the ellipsis.
    """
    return json.loads(json.dumps(value, default=partial(_json_value, less)))


def _json_value(less: Container[str], value: Any) -> Any:
    """Return data for a ``value`` that JSON lacks; its parts may be such values again. Raises
    ``InvalidInput`` for an object of an unknown kind. For ``less`` see ``canonical``."""
    value = getattr(value, "py_func", value)  # the Python source of a compiled function
    if is_dataclass(value) and not isinstance(value, type):
        kind, own = type(value), {}
        for f in fields(value):
            if f.init and f"{kind.__qualname__}.{f.name}" not in less:
                entry, registry = getattr(value, f.name), f.metadata.get(REGISTRY)
                own[f.name] = registry[entry] if registry else entry
        return {f"{kind.__module__}.{kind.__qualname__}": own}
    match value:
        case Mapping():
            return [*value.items()]
        case Set():
            return sorted(value, key=repr)
        case np.ndarray() | np.generic():
            return [value.dtype.str, value.tolist()]
        case partial():
            return [value.func, value.args, value.keywords]
        case MethodType():
            return [value.__func__, value.__self__]
        case FunctionType():
            code, known = value.__code__, value.__globals__
            held = [cell.cell_contents for cell in value.__closure__ or ()]
            named = {name: known.get(name) for name in code.co_names}
            data = {k: v for k, v in named.items() if isinstance(v, int | float | str | np.ndarray)}
            name = value.__module__, value.__qualname__
            return [name, code, value.__defaults__, value.__kwdefaults__, held, data]
        case CodeType():
            return [value.co_code, value.co_names, value.co_consts]
        case bytes():
            return sha256(value).hexdigest()
        case Path() | complex() | EllipsisType() | type() | np.ufunc():
            return repr(value)
    remedy = "cannot be compared with what is stored; do without, or store nothing"
    raise InvalidInput(type(value).__name__, value, remedy)
