"""The gate lets right answers through, stops wrong ones, and keeps claims apart from both."""

import json
from dataclasses import dataclass, replace
from typing import get_args

import pytest

import cases.compare.routes
from averaging.nonintegrable import NonIntegrable
from averaging.theory import Exact
from cases.compare.claims import Verdict
from cases.scene.scene import shipped_scenes

SCENES = ("fig3c", "sdof")
KEYS = {"scene", "curves", "judged", "certificates", "problems", "claims", "seconds", "holds"}


@dataclass(frozen=True)
class TenPercentOff(NonIntegrable):
    """The theory of a system whose stops stand ten percent too far."""

    def prepare(self, system):
        contacts = tuple(replace(c, clearance=1.1 * c.clearance) for c in system.contacts)
        return super().prepare(replace(system, contacts=contacts))


def test_the_gate_holds_on_shipped_scenes(fpk):
    status, out, err = fpk("verify", *SCENES, "--coarse", "--json", "--seed", 7)
    record = json.loads(out)
    assert (status, err, out.count("\n")) == (0, "", 1)
    assert record.keys() == {"schema", "scenes", "holds", "claims", "seconds"} and record["holds"]
    assert [s["scene"] for s in record["scenes"]] == list(SCENES)
    for scene in record["scenes"]:
        assert scene.keys() == KEYS and scene["judged"] > 0 and scene["certificates"] > 0
    assert list(record["claims"]) == [v.replace(" ", "_") for v in get_args(Verdict)]
    assert record["claims"]["does_not_hold"] >= 2  # h = 10 and 20 of Fig. 3(c) are not Gaussian


def test_the_gate_ends_with_one_table_and_fails_on_a_wrong_system(fpk, monkeypatch):
    def methods(**_):
        return (Exact(), TenPercentOff())

    monkeypatch.setattr(cases.compare.routes, "all_methods", methods)
    status, out, err = fpk("verify", "fig3a", "sdof")
    lines = out.splitlines()
    assert status == 1 and "differ by L1" in err and "FAIL" in lines[0]
    assert lines[0].startswith("fig3a") and lines[1].startswith("sdof")
    assert lines[-1] == "fails: fig3a, sdof" and sum("every scene" in x for x in lines) == 1


def test_a_scene_about_which_nothing_is_judged_does_not_pass(fpk, monkeypatch):
    monkeypatch.setattr(cases.compare.routes, "all_methods", lambda **_: (NonIntegrable(),))
    status, _, err = fpk("verify", "fig6a")
    assert status == 1 and "no comparison was judged" in err


def test_an_unknown_scene_is_refused_before_anything_is_run(fpk):
    status, out, err = fpk("verify", "fig3a", "fig3z")
    assert (status, out) == (2, "") and err.count("\n") == 1 and "fig3z" in err


@pytest.mark.slow
def test_every_shipped_scene_holds(fpk):
    status, out, err = fpk("verify")
    assert (status, err) == (0, "")
    gated = [name for name, path in shipped_scenes().items() if path.parent.name != "hard"]
    assert all(any(x.startswith(name) for x in out.splitlines()) for name in gated)


def test_a_scene_whose_simulation_would_take_too_long_is_cut_and_says_so(fpk, monkeypatch):
    monkeypatch.setattr("cases.command.studies.VERIFY_SECONDS", 1e-3)
    status, out, err = fpk("verify", "sdof", "--json")
    assert status == 1 and not json.loads(out)["holds"]
    assert "simulation" in err and "the limit of 0.001 s came" in err
