"""
Simulation of the full system
=============================

Trajectories of Eq. (6), sampled: a density by simulation beside the exact one. What separates them
is chance, and is judged at a false-alarm rate of 1e-6.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import fpk
from fpk.answer.density import l1_distance
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

# %%
# The histogram as a function, with two standard errors, and the exact density.

q = np.linspace(-2.5, 2.5, 201)
value, error = sampled.at(q)
figure, axes = plt.subplots()
axes.fill_between(q, value - 2 * error, value + 2 * error, alpha=0.4, label="simulation")
axes.plot(q, exact(q), "k--", lw=1, label="exact")
axes.set(xlabel="$q_1$", ylabel="$p(q_1)$")
axes.legend()
