"""First passage of dH = (D' − cH) dt + √(2D'H) dB beside ``kramers``.

    python benchmarks/passage.py [--out docs/benchmarks/passage.md]

``kramers`` is optional (``pip install kramers``): a missing one is said in its row.
"""

import argparse
from collections.abc import Callable
from decimal import Decimal, getcontext
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np
from report import machine, markdown_table

from averaging.energy_process import energy_process
from averaging.nonintegrable import NonIntegrable
from fpk.answer.certificate import DISTANCE_FACTOR
from fpk.answer.method import silent
from fpk.answer.names import REST, parse_limit
from fpk.solvers.line.time.passage import chain_first_passage
from fpk.system.system import System

try:
    from kramers import FirstPassage1D
except ImportError:
    FirstPassage1D = None

C, D, REPEATS = 0.1, 0.05, 7
SYSTEM, NONE = System([1.0], [1.0], [C], [D]), np.zeros(0)
RATE = Decimal("0.013742123052434446456435685415798034")
"""c times the least a with 1F1(−a; 1; 3) = 0, by mpmath in 40 digits."""
HEADER = ["x", "by", "value", "true error", "stated error", "ms"]
getcontext().prec = 60
Answer = tuple[float, float]


def exact_mean(x: int) -> Decimal:
    """Return (Ei(x) − ln x − γ)/c, from H = 0 to x D'/c, by its series Σ x^k/(k k!)."""
    term, total = Decimal(1), Decimal(0)
    for k in range(1, 6 * x + 200):
        term *= Decimal(x) / k
        total += term / k
    return total / Decimal(repr(C))


def ours(solver: str, asked: str, x: int) -> Answer:
    """Return the mean or the rate of vibro-fpk, computed with all else that a passage holds."""
    method, limit = NonIntegrable(solver=solver), parse_limit(f"H={x * D / C!r}", 1)
    one = method.passage(SYSTEM, limit, REST, NONE, tol=1e-10, progress=silent)
    return getattr(one, asked).value, getattr(one, asked).error


def mean_alone(x: int) -> Answer:
    """Return the mean by the elements, without variance and the check by the forward equation."""
    solved = chain_first_passage(energy_process(SYSTEM), x * D / C, times=NONE)
    each = zip(solved.pair, solved.means, strict=True)
    value, other = (float(e.at(np.zeros(1), T)[0][0]) for e, T in each)
    return value, DISTANCE_FACTOR * abs(value - other) + solved.relative * value


def kramers(low: float, asked: str, x: int) -> Answer:
    """Return what ``kramers`` gives: in H from ``low`` >= 0, or in ln H from ``low`` < 0."""
    given = {"log_psi": lambda H: np.log(H) - C / D * H, "D": lambda H: D * np.asarray(H)}
    ends, left = (low, x * D / C), "reflecting"
    if low < 0.0:
        given = {"log_psi": lambda y: -C / D * np.exp(y), "D": lambda y: D * np.exp(-np.asarray(y))}
        ends, left = (-np.inf, np.log(x * D / C)), "natural"
    one = FirstPassage1D(**given, domain=ends, left=left, right="absorbing")
    result = one.decay_rate() if asked == "rate" else one.mean_time(low)
    return float(result.value), float(result.error)


def row(x: int, name: str, exact: Decimal, call: Callable[[], Answer]) -> list[str]:
    """Return one row: relative true and stated error, median of ``REPEATS`` after a warm-up."""
    if name.startswith("kramers") and FirstPassage1D is None:
        return [str(x), name, "not installed", *["–"] * 3]
    times = []
    try:
        with np.errstate(all="ignore"):
            for _ in range(REPEATS + 1):
                begin = perf_counter()
                value, error = call()
                times.append(1e3 * (perf_counter() - begin))
    except ValueError as refusal:
        return [str(x), name, f"refused: {str(refusal).split(': ')[-1]}", *["–"] * 3]
    wrong = " (below the true one)" if abs(Decimal(value) - exact) > Decimal(error) else ""
    true, stated = float(abs(Decimal(value) / exact - 1)), f"{error / value:.1e}{wrong}"
    return [str(x), name, f"{value:.16g}", f"{true:.1e}", stated, f"{median(times[1:]):.2f}"]


def rows(asked: str, x: int, exact: Decimal) -> list[list[str]]:
    """Return the rows of one limit."""
    calls = {f"vibro-fpk {s}": partial(ours, s, asked) for s in ("closed-form", "fem")}
    if asked == "mean":
        calls["vibro-fpk fem, mean alone"] = mean_alone
    calls["kramers, from 0"] = partial(kramers, 0.0, asked)
    calls["kramers, cut by hand at 1e-6"] = partial(kramers, 1e-6, asked)
    calls["kramers, in ln H, by hand from −60"] = partial(kramers, -60.0, asked)
    return [row(x, name, exact, partial(call, x)) for name, call in calls.items()]


TEXT = """# First passage beside other programs

Written by `benchmarks/passage.py`: dH = (D' − cH) dt + √(2D'H) dB from H = 0, c = {c}, D' = {D}. {machine}.

## Mean time to H = x D'/c

Relative errors against (Ei(x) − ln x − γ)/c in 60 digits, medians of {repeats}. vibro-fpk's rows take the time of
mean, variance, rate and checks at once, but for `mean alone`; those of `kramers` of one number. `kramers` refuses
σ²(0) = 0: its user cuts the domain, of which its stated error knows nothing, or changes the coordinate to ln H.

{means}
## Failure rate

{rates}
"""  # noqa: E501


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/passage.md"))
    out = parser.parse_args().out.resolve()
    means = [line for x in (3, 30, 200, 500) for line in rows("mean", x, exact_mean(x))]
    rates = rows("rate", 3, RATE)
    tables = {"means": (HEADER, means), "rates": (HEADER, rates)}
    made = {key: markdown_table(*table) for key, table in tables.items()}
    about = {"c": C, "D": D, "repeats": REPEATS, "machine": machine()}
    out.write_text(TEXT.format(**about, **made))


if __name__ == "__main__":
    main()
