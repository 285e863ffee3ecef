"""The step that each scheme may take for p(q2) to 0.1 %, here and in whole-array NumPy, as JSON.

    python benchmarks/steps.py

Measured and chosen as the packages for SDEs are (``sde_peers``): by the L1 of p(q2) and the plain
mean of q2² against the closed form, at steps where the bias is seen, by the weak order from there.
Processor time of one core; a process of its own, since ``trial`` sets the threads of libraries.
"""

import json
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent / "sde_peers"))

import ours
import peer_numpy
import trial

OURS, NUMPY = "this program", "NumPy"

SETTINGS = (*ours.SETTINGS, trial.Setting("euler_maruyama", 0.01, 1, 8192))
"""Those of the comparison with packages, and the compiled baseline of the first order."""


def measured() -> list[dict]:
    """Return the lines of kind ``scheme`` of all settings."""
    found = [{"peer": OURS} | ours.tried(setting, None) for setting in SETTINGS]
    return found + [
        {"peer": NUMPY} | trial.tried(setting, peer_numpy.walk, None)
        for setting in peer_numpy.SETTINGS
    ]


def rows(lines: list[dict]) -> list[dict]:
    """Return the line that speaks for each scheme; where no bias was resolved, the finest step's.

    That one's ``allowed`` is None then.
    """
    found = []
    for peer, scheme in dict.fromkeys((line["peer"], line["scheme"]) for line in lines):
        same = [line for line in lines if (line["peer"], line["scheme"]) == (peer, scheme)]
        found.append(trial.best(same, (peer,)) or min(same, key=lambda line: line["step"]))
    return found


if __name__ == "__main__":
    print(json.dumps(rows(measured())))
