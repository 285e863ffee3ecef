"""What every command prints with ``--json``: one object, plain keys, numbers as numbers."""

import json
import re

import pytest

ASKED = {
    "list": [],
    "check": ["fig6a"],
    "show": ["fig6a"],
    "density": ["fig3a", "--method", "exact", "--of", "q2", "--at", "0,1"],
    "transient": ["cir", "--method", "integrable", "--of", "H", "--times", "1", "--at", "0.1"],
    "passage": ["cir", "--method", "phase-space", "--limit", "q1=1"],
    "crossings": ["fig3a", "--method", "exact", "--of", "q2", "--at", "0"],
    "spectrum": ["cir", "--method", "linear", "--of", "q1", "--at", "0"],
    "correlation": ["cir", "--method", "linear", "--of", "q1", "--at", "0"],
    "relaxation": ["cir", "--method", "integrable"],
    "run": ["two-modes", "--method", "integrable/closed-form"],
    "sweep": ["fig3a", "--vary", "contact.clearance=0.5,1", "--quantity", "rms(q2)"],
}
NUMBERS = {"mass_defect", "minimum", "residual", "tail_mass", "net_flux"}
CHECKS = NUMBERS | {"failures", "missed", "certified"}


def entries(record, path=""):
    """Every key with its path and value, below lists and objects."""
    children = record.items() if isinstance(record, dict) else enumerate(record)
    for key, value in children:
        yield f"{path}.{key}", key, value
        if isinstance(value, (dict, list)):
            yield from entries(value, f"{path}.{key}")


def refused(constant):
    raise ValueError(constant)


@pytest.mark.parametrize("command", ASKED)
def test_json_is_one_object_of_plain_keys_and_numbers(command, fpk):
    status, out, _ = fpk(command, *ASKED[command], "--json")
    record = json.loads(out, parse_constant=refused)  # no NaN, no Infinity
    assert status == 0 and record["schema"] == 2
    count = 0
    for path, key, value in entries(record):
        count += 1
        assert isinstance(key, int) or key in ("L1", "L2") or re.fullmatch("[a-z0-9_]+", key), path
        assert not (isinstance(value, str) and re.fullmatch(r"-?[\d.]+(e[-+]?\d+)?", value)), path
        if key == "certificate":
            assert value.keys() == CHECKS, path
    assert count > 5


def test_curves_have_one_shape(fpk):
    (_, shown, _), (_, run, _) = (
        fpk("show", "fig6a", "--json"),
        fpk("run", "fig6a", "--of", "H", "--method", "nonintegrable/closed-form", "--json"),
    )
    shown, run = json.loads(shown)["curves"], json.loads(run)
    of_run = [{key: c[key] for key in ("label", "key", "value")} for c in [run, *run["curves"]]]
    assert shown == of_run and [c["value"] for c in shown] == [10.0, 0.1, 1.0]
    assert {c["key"] for c in shown} == {"contact.stiffness"}


def test_what_does_not_apply_is_null_and_what_answered_is_named(fpk):
    rates = json.loads(fpk("relaxation", *ASKED["relaxation"], "--json")[1])
    assert rates["certificate"]["mass_defect"] is None is rates["certificate"]["tail_mass"]
    passage = json.loads(fpk("passage", *ASKED["passage"], "--json")[1])
    assert passage["solver"] == "fem" and passage["certificate"]["tail_mass"] is None
    assert passage["certificate"]["residual"] > 0.0  # measured
