"""The figures to reach: this program's time against the peers' at equal error, measured.

A time "at an error" is that of the fastest measured setting whose L1 error is at most that; nothing
is interpolated. Of this program there are two: from the system on, as a user has it, and from the
averaged process on. The peers are given the integrals of the averaged process, too: none of them
reads a system, reduces its potential or finds its contact energies.
"""

from collections.abc import Callable, Sequence
from math import inf

OURS = "vibro-fpk"
GIVEN = "hp on the peers' coefficients"
PROCESS = "hp from the averaged process on"
ALONE = "coefficients alone"
PLANES = ("W2", "W3", "W4")
NOT_ANALYTIC = ("W1, B = 1e4", "W1, two contact energies", "W1, one-sided")
Line = dict
Choice = Callable[[Line], bool]


def fastest(lines: Sequence[Line], problem: str, choice: Choice, error: float) -> Line | None:
    """Return the fastest measurement of ``problem`` with at most that L1 error, if there is one."""
    fit = [
        line
        for line in lines
        if line["problem"] == problem and line["L1"] is not None
        and line["L1"] <= error and choice(line)
    ]  # fmt: skip
    return min(fit, key=lambda line: line["seconds"], default=None)


def whole(line: Line) -> bool:
    """This program from the system on."""
    return line["peer"] == OURS and line["setting"].startswith(("hp, ", "quadrature"))


def given(line: Line) -> bool:
    """This program from the averaged process on; in two energies that takes next to nothing."""
    return line["peer"] == OURS and line["setting"].startswith(PROCESS)


def peer(name: str, word: str = "") -> Choice:
    """Measurements of a peer whose setting contains ``word``."""
    return lambda line: line["peer"] == name and word in line["setting"]


def graded(line: Line) -> bool:
    """NGSolve with p = 8 on graded meshes."""
    return line["peer"] == "NGSolve" and line["setting"].startswith("p = 8")


def targets(lines: Sequence[Line]) -> list[list[str]]:
    """Return rows: figure, peer's time, ours, ratio wanted and measured, and whether it is met."""
    split = ("Chebyshev, split at H_c", peer("Chebyshev", "split at"), 1.0)
    mapped = ("Chebyshev, split and mapped (by hand)", peer("Chebyshev", "mapped"), 1.0)
    ngsolve = ("NGSolve p = 8, graded", graded, 3.0)
    rows = []
    for words, choice, wanted in (split, mapped, ngsolve):
        against = fastest(lines, "W1", choice, 1e-10)
        rows += _against(lines, "W1", f"{words}, at 1e-10", against, wanted)
    rows += _bests(lines)
    rows += _coefficients(lines)
    for problem in PLANES:
        against = fastest(lines, problem, peer("Chebyshev"), 1e-10)
        rows += _against(lines, problem, "Chebyshev, tensor, at 1e-10", against, 1.0)
        against = fastest(lines, problem, graded, 1e-9)
        rows += _against(lines, problem, "NGSolve p = 8, at 1e-9 (ours at 1e-10)", against, 10.0)
    for problem in (*PLANES, *NOT_ANALYTIC):
        against = fastest(lines, problem, lambda line: line["peer"] != OURS, 1e-10)
        words = "the fastest of all peers, at 1e-10"
        if against:
            words += f": {against['peer']}, {against['setting']}"
        rows += _against(lines, problem, words, against, 1.0)
    return rows


def _against(
    lines: Sequence[Line], problem: str, words: str, against: Line | None, wanted: float
) -> list[list[str]]:
    """Rows for both of ours against one peer's time."""
    rows = []
    for kind, choice in (("from the system on", whole), ("from the process on", given)):
        if choice is given and problem in PLANES:
            continue
        own = fastest(lines, problem, choice, 1e-10)
        rows.append(
            [
                problem,
                f"{words}; {kind}",
                _ms(against),
                _ms(own),
                f"≥ {wanted:g}",
                *_judged(against, own, wanted),
            ]
        )
    return rows


def _judged(against: Line | None, own: Line | None, wanted: float) -> list[str]:
    """Return the ratio of times and the verdict; a peer that never gets there is slower."""
    if own is None:
        return ["–", "no: not reached, or not measured"]
    if against is None:
        return ["–", "yes: no measured setting of the peer gets there"]
    ratio = against["seconds"] / own["seconds"]
    return [f"{ratio:.2g}", "yes" if ratio >= wanted else "no"]


def _bests(lines: Sequence[Line]) -> list[list[str]]:
    """One row a peer of the rest: its time to its own best error against ours to 1e-10."""
    others = {
        "scikit-fem": peer("scikit-fem"),
        "NGSolve, P2 uniform": peer("NGSolve", "uniform"),
        "Chebyshev, one domain": peer("Chebyshev", "one domain"),
        "Chang-Cooper": peer("Chang-Cooper"),
        "FiPy": peer("FiPy"),
        "fplanck, from the potential": peer("fplanck", "potential"),
        "fplanck, from the force": peer("fplanck", "force"),
        "py-pde": peer("py-pde"),
    }
    rows = []
    for name, choice in others.items():
        fit = [
            line
            for line in lines
            if line["problem"] == "W1" and choice(line) and line["L1"] is not None
        ]
        if fit:
            best = min(fit, key=lambda line: line["L1"])
            words = f"{name}, at its best, {best['L1']:.0e}; from the system on, at 1e-10"
            own = fastest(lines, "W1", whole, 1e-10)
            row = ["W1", words, _ms(best), _ms(own), "≥ 100"]
            rows.append([*row, *_judged(best, own, 100.0)])
    return rows


def _coefficients(lines: Sequence[Line]) -> list[list[str]]:
    """Our time at 1e-10 in units of what its coefficients alone take."""
    alone = fastest(lines, "W1", lambda line: line["setting"].startswith(ALONE), inf)
    rows = []
    for kind, choice in (("from the system on", whole), ("from the process on", given)):
        own = fastest(lines, "W1", lambda x, c=choice: c(x) and "tol 1e-10" in x["setting"], inf)
        words = f"the coefficients alone (hp, tol 1e-10); {kind}"
        row = ["W1", words, _ms(alone), _ms(own), "≥ 0.33"]
        rows.append([*row, *_judged(alone, own, 1.0 / 3.0)])
    return rows


def _ms(line: Line | None) -> str:
    return "–" if line is None else f"{1e3 * line['seconds']:.3g}"
