"""The page of the packages for SDEs, as Markdown, from their lines."""

from collections.abc import Mapping, Sequence

from report import machine, markdown_table
from trial import best

Line = dict
OURS = "vibro-fpk"
BY_HAND = "NumPy"
SCRIPTS = {
    OURS: "ours.py",
    BY_HAND: "peer_numpy.py",
    "diffrax": "peer_diffrax.py",
}
INTRODUCTION = """\
The full system (6) of fig6 with B = 10, δ = 0.5 and c = (0.2, 0.4), D = (0.1, 0.2): c/D equal, so
that p(q2) is exact. Float64, one core, processor time; medians of repeats after a warm-up,
compilation apart. Each scheme is run at a step where its bias can be seen. *L1* is ∫|p_h − p| of q2
in 64 bins and beyond, sampling noise taken off in quadrature (by two halves of the paths); the
allowed step is that where L1 is 0.1 %, by the theoretical weak order, never longer than the step
measured. For comparison the same with the bias of E q2² (*by E q2²*).

L1 of the noise falls as A/√(paths × time), A being that of the exact density sampled every 0.4:
measured with this program. The time to 0.1 % is (A/1e-3)² times ns per path and unit time.
"""
FOUND = """\
- diffrax 0.7.2: the default `adjoint` refuses `UnsafeBrownianPath`; it says what to do. A
  `lineax.FunctionLinearOperator` as diffusion runs with Euler and Heun and fails with a `TypeError`
  in ShARK and SRA1. SEA, of first order in the drift, gave NaN of all paths at a step of 0.1,
  without a word (`throw=False` was given for speed).
"""
OMISSIONS = """\
- The time is that of stepping, nothing observed, and of sampling alone: burn-in, start, imports and
  compilation are not in it (*first call* has the last), and neither is a histogram, which would
  cost slow packages relatively less.
- L1 in the end has both parts in it, 0.1 % of bias and 0.1 % of noise: some 0.14 % together. It is
  the same for all. Best would be a shorter step and less noise for low orders; not optimised.
- Between the step measured and the step allowed the weak order of theory is trusted. It is that of
  smooth forces; the contact force has no second derivative where contact begins, and orders of
  three and four may be less. Ours is of fourth order and gains by that trust as diffrax's Langevin
  solvers do, of third. Where a scheme was run at two steps both are in the table.
- A scheme that was run at several steps above the allowed one is represented by the finest; of the
  schemes of a package the one with the least ns a unit of time is taken, in favour of the peer.
- One way of using each package, by authors who know this program best. Tried: paths at once (512 to
  8192), JAX's generators (`unsafe_rbg` gains nothing that lasts) and a loop of the user's own for
  diffrax. Not tried: float32, GPUs, two cores, adaptive steps, multilevel sampling, Julia's
  DifferentialEquations, implicit schemes, diffrax's VirtualBrownianTree (it is for adaptive steps).
  torchsde, three times as slow as diffrax at its best, is no longer compared.
- Unfair to the peers: they step any equation, given as one function; ours steps mechanical systems
  with contacts and integrates their linear part exactly. The schemes of the NumPy script, on the
  other hand, know of the mechanics and are by hand.
- Unfair to this program: diffrax's Langevin solvers take this system only because D/c is the same
  for both masses; fig6 as printed they cannot express with one potential.
- Unfair to this program: no peer has errors, histograms, streams that threads do not change, or a
  check of its step.
- Processor time is not quite free of what else a machine does: shared caches and clocks have moved
  it by a third.
"""


def written(lines: Sequence[Line], stopped: Mapping[str, str]) -> str:
    """Return the page."""
    versions = sorted({f"{line['peer']} {line['version']}" for line in lines})
    missing = "; ".join(f"{peer}: {why}" for peer, why in stopped.items()) + "." if stopped else ""
    parts = [
        "# The full system by packages for stochastic differential equations\n",
        "Written by `benchmarks/sde_peers/compare.py`."
        f" {machine()}. {', '.join(versions) or 'Nothing was run'}.\n",
        INTRODUCTION,
        _constant(lines),
        "## Missing\n",
        f"{missing or 'None: every script ran to its end.'}\n",
        "## In short\n",
        "Each package at its own best step; ns per path and unit time:\n",
        "<!-- table: sde -->",
        short_table(lines),
        "<!-- end -->\n",
        "## All measurements\n",
        markdown_table(
            ["package", "scheme", "step", "weak order", "paths", "ns a step", "first call, s",
             "L1", "allowed step", "ns a unit of time", "s to 0.1 %", "note"],
            [_row(line) for line in lines if line["kind"] == "scheme"],
        ),
        "## Failures\n",
        "By rule: paths lost, no answer, no step found.\n",
        markdown_table(["package", "scheme", "what is wrong"], failures(lines)),
        "Found while these scripts were written:\n",
        FOUND,
        "## Omissions\n",
        OMISSIONS,
    ]  # fmt: skip
    return "\n".join(parts)


def short_table(lines: Sequence[Line]) -> str:
    """Return a row for each package: its best scheme beside ours."""
    own, rows = best(lines, (OURS,)), []
    for peer in SCRIPTS:
        found = best(lines, (peer,))
        if found is None or own is None:
            continue
        seconds = f"{found['seconds']:.3g}" if found["seconds"] else "–"
        rows.append(
            [f"**{peer}**" if peer == OURS else peer, found["scheme"], f"{found['allowed']:.2g}",
             f"{found['ns']:.3g}", f"{found['ns_time']:.3g}", seconds,
             f"{found['ns_time'] / own['ns_time']:.3g}"]
        )  # fmt: skip
    header = ["p(q2) to 0.1 %", "scheme", "step", "ns a step", "ns a unit of time", "s"]
    return markdown_table([*header, "times ours"], rows)


def failures(lines: Sequence[Line]) -> list[list[str]]:
    """Return rows: package, scheme, what is wrong."""
    rows = []
    for line in lines:
        if line["kind"] != "scheme":
            continue
        if line["ns"] is None:
            words = line["note"]
        elif line["lost"]:
            words = f"{100 * line['lost']:.1f} % of the paths lost at {line['step']:g}"
        elif line["L1"] is not None and line["allowed"] is None:
            words = f"no step found: at {line['step']:g} L1 is lost in its noise"
        else:
            continue
        rows.append([line["peer"], line["scheme"], words])
    return rows


def _constant(lines: Sequence[Line]) -> str:
    found = [line for line in lines if line["kind"] == "sampling"]
    if not found:
        return "A was not measured: no times are derived.\n"
    a = found[0]
    words = f"A = {a['A']:.2f}, its scatter over four levels {a['scatter']:.2f}. Checked with the"
    words += f" histogram in the time: L1 {a['L1']:.2e} in {a['seconds']:.3f} s of wall time"
    return f"{words}, one thread.\n"


def _row(line: Line) -> list[str]:
    def number(key: str, form: str) -> str:
        return "none" if line[key] is None else format(line[key], form)

    L1 = "none" if line["L1"] is None else f"{line['L1']:.1e} ± {line['L1_error']:.0e}"
    return [
        line["peer"], line["scheme"], f"{line['step']:g}", str(line["order"]), str(line["paths"]),
        number("ns", ".3g"), number("first", ".2g"), L1, number("allowed", ".2g"),
        number("ns_time", ".3g"), number("seconds", ".3g"),
        line["note"].replace("|", "/"),
    ]  # fmt: skip
