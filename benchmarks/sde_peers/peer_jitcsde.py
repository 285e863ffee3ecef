"""jitcsde: equations compiled to C, here a system of many copies of the chain, constant steps.

Its integrator for additive noise is Rößler's SRA1 with an adaptive step; with a tolerance that is
never missed, and a longest step, the step is constant. It draws noise for displacements, too, and
one path at a time: copies in one system are what spares Python's time for each step.
"""

from contextlib import chdir
from tempfile import TemporaryDirectory

import numpy as np
from problem import Array, Chain
from trial import Setting, Walk, measure_all  # first: it knows the way to ``installed``

# isort: split

from installed import need

SETTINGS = (
    Setting("SRA1, 512 copies", 0.2, 2, 512),
    Setting("SRA1, 512 copies", 0.1, 2, 512, 5.0),
    Setting("SRA1, 2 copies", 0.2, 2, 2, 0.2),
)
NEVER = 1e12
"""Tolerance that no step misses."""


def walk(setting: Setting, chain: Chain, start: Array, seed: int) -> Walk:
    """Return the walk of a setting."""
    symengine, jitcsde = need("symengine"), need("jitcsde")
    y = jitcsde.y
    paths = setting.paths

    def drift() -> object:
        for k in range(paths):
            yield y(4 * k + 2)
            yield y(4 * k + 3)
            q1, q2 = y(4 * k), y(4 * k + 1)
            right = q2 - chain.clearance + symengine.Abs(q2 - chain.clearance)
            left = -q2 - chain.clearance + symengine.Abs(q2 + chain.clearance)
            right, left = right / 2, left / 2
            contact = chain.B * (right * symengine.sqrt(right) - left * symengine.sqrt(left))
            (a, b), (d, e) = chain.K.tolist()
            yield -(a * q1 + b * q2 + chain.c[0] * y(4 * k + 2))
            yield -(d * q1 + e * q2 + contact + chain.c[1] * y(4 * k + 3))

    def spread() -> object:
        for _ in range(paths):
            yield from (0, 0, float(chain.noise[0]), float(chain.noise[1]))

    class Solved:
        """States (4 paths,), path by path."""

        def __init__(self) -> None:
            self.sde = jitcsde.jitcsde(drift, spread, n=4 * paths, additive=True, verbose=False)
            with TemporaryDirectory() as folder, chdir(folder):  # setuptools reads where it is
                self.sde.compile_C(simplify=False)
            self.sde.set_seed(seed)
            self.sde.set_initial_value(start.T.ravel().copy(), 0.0)
            h = setting.step
            self.sde.set_integration_parameters(
                atol=NEVER, rtol=NEVER, first_step=h, max_step=h, min_step=1e-3 * h
            )
            self.time, self.y = 0.0, start.T.ravel()

        def advance(self, steps: int) -> None:
            """Make so many steps."""
            for _ in range(steps):
                self.time += setting.step
                self.y = self.sde.integrate(self.time)

        def states(self) -> Array:
            """Return the states (4, paths)."""
            return np.asarray(self.y.reshape(paths, 4).T)

    return Solved()


if __name__ == "__main__":
    need("jitcsde")
    measure_all("jitcsde", "jitcsde", SETTINGS, walk)
