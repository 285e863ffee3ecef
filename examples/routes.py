"""
Every route that applies
========================

All routes side by side for a system whose exact solution (7) exists, and which of the three errors,
numerical, sampling or averaging, separates two of them.
"""

import matplotlib.pyplot as plt
import numpy as np

import fpk

scene = fpk.load("fig3a")  # damping in proportion to the noise: the exact solution (7) exists
answers = fpk.solve(scene.system, ["q2"])  # all that applies and does not sample
for label, p in answers.of("q2").items():
    print(f"{label:28} p(0) = {float(p(0.0)):.12f}  L1 error {p.l1_error:.1e}")
for label, reason in answers.refusals.items():
    print(f"{label:28} left out: {reason}")

comparisons = fpk.compare(answers)
for c in comparisons:
    print(c)
# What is judged holds: two answers to one equation differ by no more than their errors allow.
judged = [c for c in comparisons if c.measures == "numerical"]
assert judged
assert all(c.holds for c in judged)
assert answers["q2", "exact"].certificate.certified

# %%
# The error that each route states, over the displacement; the stops are grey walls.

q = np.linspace(-1.2, 1.2, 201)
figure, axes = plt.subplots()
axes.axvspan(0.5, 1.2, color="0.9")
axes.axvspan(-1.2, -0.5, color="0.9")
for label, p in answers.of("q2").items():
    axes.semilogy(q, p.at(q)[1], label=label)
axes.set(xlabel="$q_2$", ylabel="stated error of $p(q_2)$")
axes.legend()
