"""The full system by simulation, beside the theory: sampling error and averaging error."""

from dataclasses import replace

import fpk
from fpk.density import l1_distance
from sim.montecarlo import MonteCarlo

system = fpk.System([1.0], [1.0], [0.1], [0.05])
short = replace(MonteCarlo(), paths=4096, relaxations=20.0, seed=1)
answers = fpk.solve(system, ["q1"], methods=["exact", short])

sampled, exact = answers["q1", "montecarlo"], answers["q1", "exact"]
distance = l1_distance(sampled, exact)
print(sampled, "differs from the exact density by", distance)
(comparison,) = fpk.compare(answers)
assert comparison.measures == "sampling"
assert comparison.holds
assert distance < 0.1
