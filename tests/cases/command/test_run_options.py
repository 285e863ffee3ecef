"""What ``fpk run`` runs and prints, as its options say."""

import json

import pytest

from cases.compare.routes import chosen_methods, listed_routes
from fpk.numeric.errors import InvalidInput

QUICK = ("run", "fig3a", "--of", "q2", "--method", "exact", "--method", "nonintegrable/closed-form")


def test_only_what_is_asked_for_is_run(fpk):
    status, out, err = fpk(*QUICK, "--of", "H", "--json")
    record = json.loads(out)
    assert (status, err) == (0, "") and record["schema"] == 2
    routes = {m["route"] for m in record["methods"]}
    assert routes == {"exact", "nonintegrable/closed-form"}
    rows = record["quantities"]
    assert [*dict.fromkeys(row["observable"] for row in rows)] == ["q2", "H"]
    assert {row["route"] for row in rows} == routes
    by_name = {(r["observable"], r["quantity"], r["route"]): r for r in rows}
    rms = by_name["q2", "rms", "exact"]
    assert 0.0 < rms["error"] < 1e-12 and rms["error_kind"] == "numerical"
    of_rms = [c for c in record["quantity_comparisons"] if c["observable"] == "q2: rms"]
    assert [(c["measures"], c["norm"], c["holds"]) for c in of_rms] == [
        ("numerical", "absolute", True)
    ]
    assert not record["claims"]  # they are about all routes


def test_the_summary_has_the_quantities_first_and_the_details_every_comparison(fpk, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    status, summary, _ = fpk(*QUICK)
    assert status == 0
    lines = summary.split("\n")
    assert lines[3].split() == ["q2", "exact", "energy", "averaging"]
    assert lines[5].split()[0] == "rms" and "allowed" not in summary
    assert all(len(line) <= 80 for line in lines)
    assert "comparisons, every check holds" in lines[-2]
    _, details, _ = fpk(*QUICK, "--details")
    assert "allowed" in details and details.index("rms") < details.index("allowed")


def test_quiet_prints_problems_only(fpk):
    assert fpk(*QUICK, "--quiet") == (0, "", "")


def test_without_simulation_nothing_is_sampled(fpk):
    _, out, _ = fpk("run", "fig3a", "--of", "H", "--no-simulation", "--json")
    methods = json.loads(out)["methods"]
    assert len(methods) > 3 and not {"montecarlo", "nonintegrable/simulation"} & {
        m["route"] for m in methods
    }


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--method", "nothing"], "use one of exact"),
        (["--method", "linear"], "no route applies"),
        (["--method", "nonintegrable/nothing"], "not a solver"),
        (["--method", "montecarlo", "--no-simulation"], "leaves no method"),
        (["--of", "q9"], "--of"),
    ],
)
def test_what_cannot_be_run_is_bad_input(fpk, options, words):
    status, out, err = fpk("run", "fig3a", *options)
    assert (status, out) == (2, "") and words in err and err.count("\n") == 1


def test_methods_are_chosen_by_name_or_by_label():
    methods = [route.make() for route in listed_routes()]
    chosen = chosen_methods(methods, ["integrable", "nonintegrable/fem"], simulation=False)
    assert {m.route.label for m in chosen} == {
        "nonintegrable/fem",
        "integrable/closed-form",
        "integrable/fem",
        "integrable/quadrature",
    }
    assert chosen_methods(methods, [], simulation=True) == tuple(methods)
    with pytest.raises(InvalidInput):
        chosen_methods(methods, ["no"], simulation=True)


def test_the_version_is_that_of_the_distribution(fpk):
    status, out, _ = fpk("--version")
    assert status == 0 and out.startswith("fpk ") and out[4].isdigit()
