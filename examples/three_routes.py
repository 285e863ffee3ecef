"""
Closed form, elements and simulation of one system
==================================================

Two masses, the second between stops (Fig. 6(a) of the paper with B = 10). The averaged equation has
a closed form, Eq. (29), and is solved by finite elements, too; the simulation samples the full
system, Eq. (6). Elements and closed form differ by numerical error, the simulation and the averaged
equation by averaging error.
"""

import matplotlib.pyplot as plt
import numpy as np

import fpk
from fpk.answer.density import l1_distance
from sim import MonteCarlo

system = fpk.load("fig6a").system
methods = ["nonintegrable/closed-form", "nonintegrable/fem", MonteCarlo(relaxations=40.0)]
answers = fpk.solve(system, ["q2"], methods=methods)
closed = answers["q2", "nonintegrable/closed-form"]
elements = answers["q2", "nonintegrable/fem"]
sampled = answers["q2", "montecarlo"]

# %%
# The simulation is drawn with two standard errors, the stops as grey walls.

q = np.linspace(-1.3, 1.3, 261)
figure, axes = plt.subplots()
axes.axvspan(0.5, 1.3, color="0.9")
axes.axvspan(-1.3, -0.5, color="0.9")
value, error = sampled.at(q)
axes.fill_between(q, value - 2 * error, value + 2 * error, alpha=0.4, label="simulation")
axes.plot(q, closed(q), label="closed form (29)")
axes.plot(q, elements(q), "k--", lw=1, label="finite elements")
axes.set(xlabel="$q_2$", ylabel="$p(q_2)$")
axes.legend()

# %%
# The errors, and which kind each is.

for c in fpk.compare(answers):
    print(f"{c.a.label:26} {c.b.label:20} {c.measures:9} L1 = {c.L1:.2e} ± {c.error:.1e}")
numerical = l1_distance(closed, elements)
averaging = l1_distance(sampled, closed)
assert numerical <= closed.l1_error + elements.l1_error + 1e-14
assert 0.005 < averaging < 0.03  # 0.0126 without sampling: docs/averaging-errors.md
