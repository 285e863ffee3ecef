"""sdeint: pure Python, one system at a time; here a system of many copies of the chain.

As documented its G is a dense matrix, which only a few copies pay for. Given SciPy's sparse one, of
which it asks no more than ``dot``, it steps as many copies at once as NumPy likes. Its own order
1.0 schemes (SRI2, SRS2) need double integrals of all pairs of noises, for which additive noise has
no use; they are left out.
"""

import numpy as np
from problem import Array, Chain
from scipy.sparse import csr_array
from trial import Setting, Walk, measure_all  # first: it knows the way to ``installed``

# isort: split

from installed import need

SETTINGS = (
    Setting("stratHeun, sparse G", 0.1, 2, 8192, 5.0),
    Setting("itoEuler, sparse G", 0.01, 1, 8192, probe=True),
    Setting("stratHeun, dense G, 16 copies", 0.1, 2, 16, 0.2),
    Setting("stratHeun, dense G, 2 copies", 0.1, 2, 2, 0.2),
)


def walk(setting: Setting, chain: Chain, start: Array, seed: int) -> Walk:
    """Return the walk of a setting."""
    sdeint = need("sdeint")
    name, kind = setting.scheme.split(", ")[:2]
    paths, scheme = setting.paths, getattr(sdeint, name)
    rows, sizes = np.arange(2 * paths), np.repeat(chain.noise, paths)
    G = csr_array((sizes, (2 * paths + rows, rows)), shape=(4 * paths, 2 * paths))
    spread = G.toarray() if kind == "dense G" else G
    c = chain.c[:, None]

    def drift(y: Array, t: float) -> Array:
        q, p = y.reshape(2, 2, paths)
        return np.concatenate([p, -chain.force(q) - c * p]).ravel()

    class Solved:
        """States (4 paths,), all q1 first."""

        def __init__(self) -> None:
            self.y, self.rng = start.ravel().copy(), np.random.default_rng(seed)

        def advance(self, steps: int) -> None:
            """Make so many steps in one solution, which keeps them all."""
            times = setting.step * np.arange(steps + 1)
            with np.errstate(over="ignore", invalid="ignore"):  # lost paths are counted at the end
                self.y = scheme(drift, lambda y, t: spread, self.y, times, generator=self.rng)[-1]

        def states(self) -> Array:
            """Return the states (4, paths)."""
            return self.y.reshape(4, paths)

    return Solved()


if __name__ == "__main__":
    need("sdeint")
    measure_all("sdeint", "sdeint", SETTINGS, walk)
