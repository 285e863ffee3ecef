"""
One system, three methods, ten lines
====================================

Load a scene, solve it by three methods, and read off what an engineer asks for: rms, quantiles, how
often and how hard the stops are hit. Every number has its error, every difference its kind.
"""

import fpk
from sim import MonteCarlo

system = fpk.load("fig6a").system
methods = ["nonintegrable/fem", "integrable/closed-form", MonteCarlo(relaxations=40.0, seed=7)]
answers = fpk.solve(system, ["q2"], methods=methods)

table = answers.summary()
print(table.xs("value", axis=1, level=1).round(4).to_string())
print(table.xs("error", axis=1, level=1).round(6).to_string())

# %%
# What separates the methods. Differences by averaging are reported; all others are judged.

for c in fpk.compare(answers):
    print(f"{c.a.label:24} {c.b.label:24} {c.measures:10} L1 = {c.L1:.4f} ± {c.error:.0e}")

# %%
# The tails: both theories against the simulation, with two standard errors.

figure = answers.plot("q2", log=True)

# %%
# Labelled arrays, for whatever comes next.

data = answers.to_xarray()
print(data)

# %%
# The energy-averaged rms is within 1 % of the simulated one; averaging the modes, which leaves the
# contacts out, is almost twice too large.

rms = table.loc[("q2", "rms")]
true = rms["montecarlo", "value"]
print(f"simulated {true:.4f} ± {rms['montecarlo', 'error']:.4f}")
assert rms["montecarlo", "error"] < 1e-3
print(f"energy averaging {rms['nonintegrable/fem', 'value'] / true - 1.0:+.4f} of itself")
assert 0.003 < 1.0 - rms["nonintegrable/fem", "value"] / true < 0.01
assert rms["integrable/closed-form", "value"] > 1.85 * true
assert not answers.problems
