"""torchsde (PyTorch): ``sdeint`` over all paths as its batch, additive noise, float64, one thread.

Noise by ``BrownianInterval`` made for steps of this size without a cache beyond what they need,
the way its documentation makes it fast for a fixed step.
"""

import numpy as np
from problem import Array, Chain
from trial import Setting, Walk, measure_all, need

PATHS = 8192
SETTINGS = (
    Setting("euler (Itô)", 0.01, 1, PATHS),
    Setting("srk (Itô)", 0.2, 2, PATHS, 3.0, note="Rößler's SRA1 where noise is additive"),
    Setting("heun (Stratonovich)", 0.15, 2, PATHS, 4.0),
    Setting("midpoint (Stratonovich)", 0.2, 2, PATHS, 3.0),
)


def walk(setting: Setting, chain: Chain, start: Array, seed: int) -> Walk:
    """Return the walk of a setting."""
    torch, torchsde = need("torch"), need("torchsde")
    torch.set_num_threads(1)
    method, calculus = setting.scheme.split()
    levy = "space-time" if method == "srk" else "none"
    K, c = torch.tensor(chain.K), torch.tensor(chain.c)
    noise = torch.tensor(chain.noise)
    spread = torch.zeros(setting.paths, 4, 2, dtype=torch.float64)
    spread[:, 2:] = torch.diag(noise)

    class Equation(torch.nn.Module):
        """The system with states (paths, 4)."""

        noise_type = "additive"
        sde_type = "ito" if calculus == "(Itô)" else "stratonovich"

        def f(self, t: object, y: object) -> object:
            """Drift."""
            q, p = y[:, :2], y[:, 2:]
            force = q @ K + c * p
            q2 = y[:, 1]
            overlap = torch.clamp(q2.abs() - chain.clearance, min=0.0)
            force[:, 1] += torch.sign(q2) * chain.B * overlap * overlap.sqrt()
            return torch.cat([p, -force], dim=1)

        def g(self, t: object, y: object) -> object:
            """Diffusion (paths, 4, 2)."""
            return spread

        def g_prod(self, t: object, y: object, v: object) -> object:
            """Diffusion times (paths, 2), without the product with a matrix of zeros."""
            return torch.nn.functional.pad(v * noise, (2, 0))

    class Solved:
        """States (paths, 4)."""

        def __init__(self) -> None:
            self.y, self.equation = torch.tensor(start.T.copy()), Equation()
            self.seed = seed

        def advance(self, steps: int) -> None:
            """Make so many steps in one solution."""
            self.seed += 1
            end = steps * setting.step
            brownian = torchsde.BrownianInterval(
                0.0, end, size=(setting.paths, 2), dtype=torch.float64, entropy=self.seed,
                dt=setting.step, levy_area_approximation=levy,
            )  # fmt: skip
            with torch.no_grad():
                ys = torchsde.sdeint(
                    self.equation, self.y, torch.tensor([0.0, end], dtype=torch.float64),
                    bm=brownian, method=method, dt=setting.step,
                )  # fmt: skip
            self.y = ys[-1]

        def states(self) -> Array:
            """Return the states (4, paths)."""
            return np.asarray(self.y.numpy().T)

    return Solved()


if __name__ == "__main__":
    need("torchsde")
    measure_all("torchsde", "torchsde", SETTINGS, walk)
