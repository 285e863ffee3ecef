"""fplanck: its steady state, from the potential and from the force.

Its units are made such that kT = 1 and the drag is 1/(½b). Its potential is −ln(½ b p) of the
closed form, so that the answer is handed to it; from the force 2 s/b it has to find it. As released
(0.2.2) it needs ``numpy.product``, which NumPy 2 took away: it is put back here.
Its drag is one number an axis, so that its diffusion is diagonal: it cannot be asked for W3.
"""

from functools import partial

from installed import need
from measure import Setting, cells, measure_all  # first: NumPy then has one thread

# isort: split

import numpy as np
from problems import PROBLEMS
from scipy import constants

fplanck = need("fplanck")

LINE_END, PLANE_END = 8.0, 20.0
NEEDS = ""
if not hasattr(np, "product"):
    np.product = np.prod
    NEEDS = "needs numpy.product, put back by hand: as released it fails with NumPy 2"


def solved(problem, count, kind):
    """Return the edges of the cells along each axis and p_h, of mass one."""
    ends = np.array([LINE_END] if problem.dimension == 1 else PLANE_END * problem.temperature)
    edges = [np.linspace(0.0, end, count + 1) for end in ends]
    middle = [0.5 * end for end in ends]

    def shifted(*x):
        """Their boxes lie around 0, ours begin there."""
        return np.array([a + m for a, m in zip(x, middle, strict=True)])

    def coefficients(*x):
        at = shifted(*x)
        found = problem.coefficients(at[0] if problem.dimension == 1 else at)
        return (np.reshape(a, at.shape) for a in found)

    def drag(*x):
        _, b, _ = coefficients(*x)
        return 2.0 / b

    def force(*x):
        s, b, _ = coefficients(*x)
        return 2.0 * s / b

    def potential(*x):
        at = shifted(*x)
        _, b, _ = coefficients(*x)
        return -np.log(problem.exact(at)) - np.sum(np.log(b), axis=0)

    given = {"force": force} if kind == "force" else {"potential": potential}
    simulation = fplanck.fokker_planck(
        temperature=1.0 / constants.k, drag=drag, extent=ends, resolution=ends / count, **given
    )
    p = simulation.steady_state()
    return edges, p / np.prod([e[1] for e in edges])


def setting(name, count, kind):
    """Return one measurement."""
    problem = PROBLEMS[name]
    unit = " an axis" if problem.dimension == 2 else ""
    made = "the potential is made of the answer" if kind == "potential" else ""
    note = "; ".join(words for words in (NEEDS, made) if words)
    return Setting(
        name, f"from the {kind}, {count} cells{unit}", partial(solved, problem, count, kind),
        lambda answer: cells(*answer), lambda answer: answer[1].size, note,
    )  # fmt: skip


if __name__ == "__main__":
    settings = [
        setting("W1", count, kind) for kind in ("potential", "force") for count in (1_000, 8_000)
    ]
    settings += [setting("W1", 200_000, kind) for kind in ("potential", "force")]
    settings += [setting("W1, B = 1e4", 16_000, "force")]
    settings += [setting("W1, two contact energies", 16_000, "force")]
    settings += [setting("W1, one-sided", 16_000, "force")]
    settings += [
        setting("W2", count, kind) for kind in ("potential", "force") for count in (32, 128, 256)
    ]
    measure_all("fplanck", "fplanck", settings)
