"""The square-root process as a model of pyTAMS, which knows no process but what its user writes."""

import json
import sys
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import toml
from pytams.fmodel import ForwardModelBaseClass
from pytams.tams import TAMS


class SquareRootModel(ForwardModelBaseClass):
    """Exact steps and the score of ``sim.questions.splitting``, the least action.

    Parameters are c, D', ...

    The score knows the maximum between two steps, by a bridge. It grows beyond the limit: where all
    paths have one score pyTAMS looks for a parent that is not least, for ever.
    """

    def _init_model(self, m_id: int, params: dict[str, Any]) -> None:
        self.p, self.X, self.most = params["model"], 0.0, 0.0
        self.stream = np.random.default_rng()

    def make_noise(self) -> list[float]:
        """Return two normal numbers and a uniform one."""
        return [*self.stream.standard_normal(2).tolist(), self.stream.random()]

    def _advance(
        self, step: int, time: float, dt: float, noise: list[float], need_end_state: bool
    ) -> float:
        (x, y, u), a, c, D = noise, np.sqrt(self.X), self.p["c"], self.p["D"]
        k, decay = D * -np.expm1(-c * dt) / (2.0 * c), np.exp(-c * dt)
        self.X = k * ((x + a * np.sqrt(decay / k)) ** 2 + y * y)
        b = np.sqrt(self.X)
        self.most = 0.5 * (a + b + np.sqrt((b - a) ** 2 - D * dt * np.log(u)))
        return dt

    def get_current_state(self) -> float:
        """Return H."""
        return float(self.X)

    def set_current_state(self, state: float) -> None:
        """Set H."""
        self.X, self.most = state, np.sqrt(state)

    def score(self) -> float:
        """Return 1 less the least action to fail in the time that is left; 1 and more beyond.

        Waiting costs nothing: the climb takes the best time, or all that is left.
        """
        c, time, top = self.p["c"], self.p["time"], np.sqrt(self.p["limit"])
        if self.most >= top:
            return float(self.most / top)
        share = max(self.most / top, 1e-9)
        climb = max(min(time - self._time, -2.0 * np.log(share) / c), 1e-9)
        short = 1.0 - share * np.exp(-0.5 * c * climb)
        return float(1.0 + short**2 / np.expm1(-c * climb))


def main() -> None:
    """Print probability, steps and seconds of one run, in one worker process; files stay here."""
    given = json.loads(sys.argv[1])
    model, replicas = given["model"], given["replicas"]
    tables = {
        "tams": {"ntrajectories": replicas, "nsplititer": 99 * replicas, "loglevel": "ERROR"},
        "trajectory": {"end_time": model["time"], "step_size": given["step"], "targetscore": 1.0},
        "runner": {"type": "asyncio"},
        "model": model,
    }
    Path("input.toml").write_text(toml.dumps(tables))
    begin = perf_counter()
    run = TAMS(SquareRootModel, [])
    P, steps = run.compute_probability(), run.get_database().count_computed_steps()
    print(json.dumps([P, steps, perf_counter() - begin]))


if __name__ == "__main__":
    main()
