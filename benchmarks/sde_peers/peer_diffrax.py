"""diffrax (JAX): ``diffeqsolve`` with constant steps over all paths at once, float64 on one core.

Noise by ``UnsafeBrownianPath``, the one for constant steps, with keys of ``rbg``, the fastest
generator that JAX holds to be sound. The noise is a term of
its own that acts on the momenta alone, so that nothing is drawn or multiplied in vain. The Langevin
solvers take this system since D/c is the same for both masses: gamma = c, u = D/c, potential V/u.
A loop of one's own over ``solver.step`` was tried, and is no faster.
"""

import os

import numpy as np
from problem import Array, Chain
from trial import Setting, Walk, measure_all, need

os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

PATHS = 4096
SETTINGS = (
    Setting("Euler", 0.01, 1, PATHS, 2.0),
    Setting("Heun", 0.15, 2, PATHS, 2.0),
    Setting("ShARK", 0.2, 2, PATHS, 2.0, note="recommended by its authors for additive noise"),
    Setting("ALIGN", 0.2, 2, PATHS, note="Langevin"),
    Setting("QUICSORT", 0.4, 3, PATHS, 3.0, note="Langevin"),
    Setting("ShOULD", 0.4, 3, PATHS, 3.0, note="Langevin"),
    Setting("ShOULD", 0.3, 3, PATHS, 8.0, note="Langevin"),
)
LEVY = dict.fromkeys(("ShARK", "ALIGN"), "SpaceTimeLevyArea")
LEVY |= dict.fromkeys(("ShOULD", "QUICSORT"), "SpaceTimeTimeLevyArea")
"""What of the Brownian path a solver needs, if more than increments."""
LANGEVIN = ("ALIGN", "ShOULD", "QUICSORT")


def walk(setting: Setting, chain: Chain, start: Array, seed: int) -> Walk:
    """Return the walk of a setting."""
    dx, jax = need("diffrax"), need("jax")
    jnp = jax.numpy
    jax.config.update("jax_enable_x64", True)
    name = setting.scheme
    c, noise = jnp.array(chain.c)[:, None], jnp.array(chain.noise)[:, None]
    (a, b), (d, e) = chain.K.tolist()
    u = float(chain.D.sum() / chain.c.sum())
    shape = jax.ShapeDtypeStruct((2, setting.paths), jnp.float64)

    class Noise(dx.AbstractTerm):
        """√(2 D) dW in the momenta of (q, p)."""

        control: dx.AbstractPath

        def vf(self, t: object, y: object, args: object) -> object:
            """Return √(2 D)."""
            return noise

        def contr(self, t0: object, t1: object, **levy: object) -> object:
            """Return the increment, with what else of the path is asked for."""
            return self.control.evaluate(t0, t1, **levy)

        def prod(self, vf: object, control: object) -> object:
            """Return the increment of (q, p)."""
            return jnp.zeros_like(control), vf * control

    def force(q: object) -> object:
        """K q + g(q2) e2, written out: XLA fuses that, and not a product with a matrix."""
        overlap = jnp.maximum(jnp.abs(q[1]) - chain.clearance, 0.0)
        contact = jnp.sign(q[1]) * chain.B * overlap * jnp.sqrt(overlap)
        return jnp.stack([a * q[0] + b * q[1], d * q[0] + e * q[1] + contact])

    def terms(key: object) -> object:
        """The equation with a Brownian path of its own."""
        levy = getattr(dx, LEVY.get(name, "BrownianIncrement"))
        brownian = dx.UnsafeBrownianPath(shape, key, levy)
        if name not in LANGEVIN:
            drift = dx.ODETerm(lambda t, y, _: (y[1], -force(y[0]) - c * y[1]))
            return dx.MultiTerm(drift, Noise(brownian))
        gamma, wide = jnp.broadcast_to(c, shape.shape), jnp.full(shape.shape, u)
        slope = dx.UnderdampedLangevinDriftTerm(gamma, wide, lambda q, _: force(q) / u)
        return dx.MultiTerm(slope, dx.UnderdampedLangevinDiffusionTerm(gamma, wide, brownian))

    solver = getattr(dx, name)()

    @jax.jit
    def solved(y: object, key: object, steps: object) -> object:
        ys = dx.diffeqsolve(
            terms(key), solver, 0.0, steps * setting.step, setting.step, y, max_steps=None,
            saveat=dx.SaveAt(t1=True), adjoint=dx.ForwardMode(), throw=False,
        ).ys  # fmt: skip
        return jax.tree.map(lambda saved: saved[0], ys)

    class Solved:
        """States (q, p) as JAX has them."""

        def __init__(self) -> None:
            self.y = (jnp.array(start[:2]), jnp.array(start[2:]))
            self.key = jax.random.key(seed, impl="rbg")

        def advance(self, steps: int) -> None:
            """Make so many steps in one solution."""
            self.key, key = jax.random.split(self.key)
            self.y = jax.block_until_ready(solved(self.y, key, float(steps)))

        def states(self) -> Array:
            """Return the states (4, paths)."""
            return np.concatenate([np.asarray(part) for part in self.y])

    return Solved()


if __name__ == "__main__":
    need("diffrax")
    measure_all("diffrax", "diffrax", SETTINGS, walk)
