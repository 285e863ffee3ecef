"""Whole-array NumPy, what is written by hand in an afternoon: Euler-Maruyama and BAOAB."""

import numpy as np
from problem import Array, Chain
from trial import Setting, Walk, measure_all

SETTINGS = (
    Setting("BAOAB", 0.3, 2, 2048),
    Setting("BAOAB", 0.15, 2, 2048, 5.0),
    Setting("Euler-Maruyama", 0.01, 1, 2048),
)


class Stepped:
    """Paths in arrays (2, paths)."""

    def __init__(self, setting: Setting, chain: Chain, start: Array, seed: int) -> None:
        """Begin at ``start`` (4, paths)."""
        self.chain, self.h = chain, setting.step
        self.q, self.p = start[:2].copy(), start[2:].copy()
        self.rng = np.random.default_rng(seed)
        self.step = self.baoab if setting.scheme == "BAOAB" else self.euler
        c, D = chain.c[:, None], chain.D[:, None]
        self.damping, self.decay = c, np.exp(-c * self.h)
        self.thermal = np.sqrt(D / c * (1.0 - self.decay**2))
        self.kick = chain.noise[:, None] * np.sqrt(self.h)

    def baoab(self) -> None:
        """Kick by all forces, drift h/2, damping and noise, drift h/2."""
        self.p -= self.h * self.chain.force(self.q)
        self.q += 0.5 * self.h * self.p
        self.p *= self.decay
        self.p += self.thermal * self.rng.standard_normal(self.p.shape)
        self.q += 0.5 * self.h * self.p

    def euler(self) -> None:
        """Everything from the start of the step."""
        force = self.chain.force(self.q) + self.damping * self.p
        self.q += self.h * self.p
        self.p += self.kick * self.rng.standard_normal(self.p.shape) - self.h * force

    def advance(self, steps: int) -> None:
        """Make so many steps."""
        with np.errstate(over="ignore", invalid="ignore"):  # lost paths are counted at the end
            for _ in range(steps):
                self.step()

    def states(self) -> Array:
        """Return the states (4, paths)."""
        return np.vstack([self.q, self.p])


def walk(setting: Setting, chain: Chain, start: Array, seed: int) -> Walk:
    """Return the walk of a setting."""
    return Stepped(setting, chain, start, seed)


if __name__ == "__main__":
    measure_all("NumPy", "numpy", SETTINGS, walk)
