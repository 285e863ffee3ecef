"""Plain records: what JSON has of numbers, arrays and the program's own records."""

import hashlib
import json
from dataclasses import fields, is_dataclass
from importlib.metadata import PackageNotFoundError, version
from math import isfinite
from typing import Any

import numpy as np

from fpk.density import AnyDensity

UNITS = "the scene's own consistent units"


def program_version() -> str:
    """Return the version of the installed distribution."""
    try:
        return version("vibro-fpk")
    except PackageNotFoundError:
        return "(not installed)"


def plain(value: Any) -> Any:
    """Return ``value`` as JSON has it: lists and numbers; what is not finite becomes null.

    A record becomes the dictionary of its fields.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float) and not isfinite(value):
        return None
    return value


def hash_of(record: dict[str, Any]) -> str:
    """Return a short hash of everything in ``record``."""
    text = json.dumps(plain(record), sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def certificate_record(density: AnyDensity) -> dict[str, Any]:
    """Return the certificate with whether it holds."""
    return {**plain(density.certificate), "certified": density.certificate.certified}
