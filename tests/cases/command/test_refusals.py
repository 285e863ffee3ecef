"""Bad input to any command: one line with the word that helps, status 2, nothing written."""

import shlex

import pytest

from cases.scene.errors import LONGEST

Q2 = "--of q2 --at 0 --method"
CROSSINGS, SPECTRUM = f"crossings fig3a {Q2}", f"spectrum fig3a {Q2}"
LAGS, ENERGY = f"correlation fig3a {Q2}", f"density fig6a {Q2} nonintegrable"
PASSAGE = "passage fig6a --method nonintegrable --limit H=1"
SIMULATED = "passage fig6a --method montecarlo --limit H=1"
MODAL = "passage fig6a --method integrable --limit"
TRANSIENT = "transient fig6a --method nonintegrable --of H --times 1,10 --at 0.1,0.5"
RUN, RELAXATION = "run fig3a", "relaxation fig3a --method"
SWEEP, VARY = (
    "sweep fig6a --vary contact.clearance=1,2 --quantity",
    "sweep fig6a --quantity rms(q2)",
)
REFUSED = [
    (f"density fig6a {Q2} exact", "exact"),
    ("density fig6a --method integrable --of q2,H1 --at '0 x 0'", "modal energies"),
    (f"density fig6a {Q2} guess", "use one of exact"),
    (f"density fig3a {Q2} exact --solver fem", "leave it out"),
    (f"{ENERGY} --solver fen", "fem"),
    (f"{ENERGY} --of q3", "q1..q2"),
    (f"{ENERGY} --at 0:1", "start:end:step"),
    ("density fig6a --method nonintegrable --of q2", "--at"),
    (f"crossings fig6a {Q2} linear", "contacts"),
    (f"crossings fig6a {Q2} exact", "condition (8)"),
    (f"crossings fig6a {Q2} integrable --solver fem", "only modal energies"),
    (f"{CROSSINGS} exact --of p1", "use a displacement, q1..q2"),
    (f"{CROSSINGS} exact --seed 3", "fpk: --seed 3: is not an option"),
    (f"{CROSSINGS} montecarlo --seconds -1", "--seconds -1.0: must be"),
    (f"{SPECTRUM} exact", "use one of linear, phase-space"),
    (f"{SPECTRUM} phase-space --of q1,p1", "use a displacement, q1..q2"),
    (f"{SPECTRUM} phase-space --at 0,y", "not a finite number"),
    (f"{SPECTRUM} phase-space --at '0 x 1'", "one list"),
    (f"{SPECTRUM} montecarlo --at 0,1e90", "ask for lower ones"),
    (f"spectrum chain-10 {Q2} phase-space", "10 masses have 20 coordinates"),
    (f"{LAGS} nonintegrable", "use one of linear, phase-space, montecarlo"),
    (f"{LAGS} phase-space --at -1:1:1", "--at -1.0: a lag is a time"),
    (f"{LAGS} montecarlo --at 0,1e90", "--at 1e+90: a lag takes"),
    (f"{RELAXATION} exact", "use one of linear, "),
    (f"{RELAXATION} phase-space --rates 0", "--rates"),
    (f"{PASSAGE} --start H=-1", "negative"),
    (f"{PASSAGE} --start q9=1", "use rest"),
    (f"{PASSAGE} --limit H=0", "> 0"),
    (f"{PASSAGE} --limit energy=1", "use H=1.5"),
    (f"{PASSAGE} --times 2,1", "ascend"),
    (f"{PASSAGE} --limit H=1e-300", "at least"),
    (f"{PASSAGE} --times nan", '--times "nan": "nan" is not a finite number'),
    (f"{PASSAGE} --times 1e300", "between 1e-100 and 1e100"),
    (f"{PASSAGE} --solver closed-form", "contacts"),
    (f"{PASSAGE} --solver quadrature", "use fem"),
    (f"{MODAL} H1=1,H2=1 --start noise=1e-6", "so narrow a density"),
    (f"{PASSAGE} --seed 3", "fpk: --seed 3: is not an option of nonintegrable by fem"),
    (f"{SIMULATED} --dt -1", "--dt -1.0: must be"),
    (f"{TRANSIENT} --threads 1", "fpk: --threads 1: is not an option"),
    (f"{TRANSIENT} --of H,q1", "two lists"),
    (f"{RUN} --method nothing", "use one of exact"),
    (f"{RUN} --method linear", "no route applies"),
    (f"{RUN} --method nonintegrable/nothing", "not a solver"),
    (f"{RUN} --method montecarlo --no-simulation", "leaves no method"),
    ("verify fig3a fig3z", "fig3z"),
    ("converge one-mass --route integrable --json", "one mass"),
    ("converge near-resonance --route integrable --json", "internal resonance"),
    ("converge fig6b --route magic", "nonintegrable"),
    ("converge fig6b --of q7", "--of"),
    ("converge fig6b --route integrable --of H", "H"),
    (f"{SWEEP} rms(q2) --method linear", "linear: no value anywhere: the system has contacts"),
    (f"{SWEEP} rms(q2) --method lin", "use one of"),
    (f"{SWEEP} mean_passage(q2=3) --method exact", "gives no first passage"),
    (f"{SWEEP} rms(q2) --tol 0", "--tol 0"),
    (f"{SWEEP} rm(q2)", "did you mean rms?"),
    (f"{SWEEP} rms", "use one of mean(q1)"),
    (f"{SWEEP} rms(q3)", "is not an observable"),
    (f"{SWEEP} rms(q1,q2)", "is a pair"),
    (f"{SWEEP} quantile(q2,1)", "between 0 and 1"),
    (f"{SWEEP} exceedance(q2,inf)", "must be a finite number"),
    (f"{SWEEP} \"exceedance(q2,__import__('os'))\"", "must be a finite number"),
    (f"{SWEEP} mean_force(2)", "use 1 to 1"),
    (f"{SWEEP} mean_force(1,up)", "use left or right"),
    (f"{SWEEP} correlation(q1)", "name a pair"),
    (f"{SWEEP} upcrossing_rate(p1,1)", "is no contact"),
    (f"{SWEEP} relaxation_rate(0)", "from 1 to 100"),
    (f"{SWEEP} relaxation_rate(101)", "from 1 to 100"),
    (f"{SWEEP} relaxation_rate({'9' * 5000})", "from 1 to 100"),
    (f"{SWEEP} failure_rate(H)", "use H=1.5"),
    (f"{SWEEP} __class__(q2)", "is no quantity"),
    (f"{VARY} --vary contact[2].clearance=1,2", "contact[1..1].clearance"),
    (f"{VARY} --vary contact[1].mass=1,2", "contact[1..1].clearance"),
    (f"{VARY} --vary contact.stiffnes=1:2:3", "contact[1..1].stiffness"),
    (f"{VARY} --vary contact.stiffness", "low:high:count"),
    (f"{VARY} --vary contact.stiffness=1:2:ln3", "logCOUNT"),
    (f"{VARY} --vary contact.stiffness=1:2:1", "count of 1"),
    (f"{VARY} --vary contact.stiffness=2:1:3", "not below"),
    (f"{VARY} --vary contact.stiffness=0:1:log3", "low end > 0"),
    (f"{VARY} --vary contact.stiffness=-1:1:3", "> 0"),
    (f"{VARY} --vary contact.stiffness=nan:1:3", "finite"),
    (f"{VARY} --vary contact.stiffness=1:2:99999", "count of 99999"),
    (f"{VARY} --vary contact.stiffness=1:2:100 --vary contact.clearance=1:2:100", "at most"),
    (f"{VARY}{' --vary contact.stiffness=1:2:3' * 3}", "3 times"),
    *(
        (f"{VARY} --vary contact[1].clearance=1,2 --vary {again}", "varied already")
        for again in ("contact.clearance=1,2", "contact[1].clearance=3:4:2")
    ),
    ("regime fig6a --vary contact.stiffness=1:2", "low:high:count"),
    (f"{VARY} --vary system.damping[1,3]=1,2", "system.damping[1..2,1..2]"),
    (f"{VARY} --vary system.mass[1,1]=1,2", "system.mass[1..2]"),
    (f"{VARY} --vary system.__class__=1,2", "is no number"),
    (f"{VARY} --vary damping_term[1].coefficient=1,2", "is no number"),
    (f"{VARY} --vary system.mass[1]=2,1", "ascend"),
    (f"{VARY} --vary system.mass[1]=1", "two numbers"),
    (f"{VARY} --vary system.mass[1]=1,x", "is no grid"),
    (f"{VARY} --vary system.mass[1]=-1,1", "positive"),
    (f"{VARY} --vary system.noise_intensity[1,2]=0,1", "semidefinite"),
    (f"{VARY} --vary contact[1].exponent=1,2", "law"),
    ("export fig6a --of H,q1 --out x.vtu", "H,q1"),
    ("export fig6a --out field.vtk", "--out"),
    ("export fig6a --out file/field.csv", "--out"),
    ("run fig6a --out file", "file"),
    ("converge fig6b --out /dev/null", "/dev/null"),
    ("new ../pipe", "letters"),
    ("new 'a\"\nb'", "letters"),
    ("new " + "a" * 65, "64"),
    ("new fig6a", "shipped"),
    ("new pipe --law steel", "bilinear, hertz, power"),
    ("new pipe --masses 501", "--masses"),
    ("new pipe --out nowhere/pipe.toml", "does not exist"),
    ("new there", "not overwritten"),
    ("new link", "not overwritten"),
    ("new", "NAME"),
    ("run fig6a --secods 1", "Did you mean '--seconds'?"),
    ("densty", "Did you mean 'density'?"),
    *((f"show {name}", "fpk: ") for name in ("''", ".", "~", "/dev/zero")),
    *((f"show {name}", "fpk: ") for name in ("a" * 5000, "a/" * 3000 + ".toml", "'\x1b[31m'")),
    ("show 'no\nsuch\0scene.toml'", "such"),
    ("show fig6", 'did you mean "fig6'),
]


@pytest.mark.parametrize(("line", "word"), REFUSED, ids=[line[-60:] for line, _ in REFUSED])
def test_bad_input_is_refused_in_one_line(line, word, refusal, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("file", "there.toml"):
        (tmp_path / name).write_text("mine")
    (tmp_path / "link.toml").symlink_to("nowhere.toml")
    assert word in (err := refusal(*shlex.split(line))) and len(err) < LONGEST + 10
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "link.toml", "there.toml"]
    assert {path.read_text() for path in tmp_path.glob("*e*") if path.is_file()} == {"mine"}


NONSENSE = {
    "--tol": ("", "nan", "inf", "-1", "0", "1", "1e400", "1e-300", "x"),
    "--seed": ("", "-1", "1.5", "nan", "x", str(2**64), "9" * 5000),
    "--threads": ("-1", "0", "x", "9" * 400),
    "--of": ("", "Q2", "q0", "q3", "q2,q2", "q2\nx", "q" * 5000, "q²", "q٢"),
    "--at": ("", "0:1:5", "0:1:0", "nan", "1e999", "0:1", ",", "9" * 5000),
    "--method": ("", "Exact", "a\nb", "x" * 5000),
    "--solver": ("", "FEM", "a\nb", "x" * 5000),
}


@pytest.mark.parametrize("option", NONSENSE)
def test_an_option_without_sense_is_named(option, refusal):
    for text in NONSENSE[option]:
        given = {"--method": "montecarlo", "--of": "q2", "--at": "0", option: text}
        err = refusal("density", "fig6a", *(word for pair in given.items() for word in pair))
        assert option in err and len(err) < LONGEST + 10


@pytest.mark.parametrize("line", ["density fig6a --dz 1", "run fig6a --paths 1"])
def test_no_hint_is_given_for_a_word_of_another_meaning(line, refusal):
    assert "Did you mean" not in refusal(*line.split())


UNUSABLE = [
    'run fig6a --out ""',
    'run fig6a --checkpoint ""',
    f'density fig6a {Q2} montecarlo --checkpoint ""',
    'converge fig6a --out ""',
    'cost fig6a --out ""',
    'regime fig6a --vary contact.stiffness=1:2:2 --out ""',
    'regime fig6a --vary contact.stiffness=1:2:2 --checkpoint ""',
    'export fig6a --out ""',
    "verify fig6a --out there",
    "export fig6a --of q9 --out missing/fields.csv",
]


@pytest.mark.parametrize("line", UNUSABLE)
def test_a_path_that_cannot_be_used_is_refused_before_the_work(
    line, refusal, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("cases.compare.stationary.run_scene", None)  # the work would be an error
    refusal(*shlex.split(line))
    assert not list(tmp_path.iterdir())
