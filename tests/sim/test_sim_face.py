"""The face of the room: importing it registers the route and compiles nothing."""

import subprocess
import sys

IMPORTED = """
import sys
import sim
from fpk.answer.method import ROUTES
assert ROUTES["montecarlo", "simulation"].make() == sim.MonteCarlo()
print([name for name in ("numba", "distributed", "sim.step.kernel") if name in sys.modules])
"""


def test_importing_the_room_is_cheap() -> None:
    done = subprocess.run([sys.executable, "-c", IMPORTED], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("[]\n", "")
