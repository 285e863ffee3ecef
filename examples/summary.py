"""
One system, three methods, ten lines
====================================

Load a scene, solve it by three methods, and read off what an engineer asks for: rms, quantiles, how
often and how hard the stops are hit; compare, plot, keep as labelled arrays, and vary a clearance.
"""

import fpk
from sim import MonteCarlo

system = fpk.load("fig6a").system
methods = ["nonintegrable", "integrable", MonteCarlo(relaxations=40.0, seed=7)]
answers = fpk.solve(system, ["q2"], methods=methods)
table = answers.summary()
print(*fpk.compare(answers), sep="\n")
answers.plot("q2", log=True)
data = answers.to_xarray()
sweep = fpk.sweep(system, {"contact[1].clearance": "0.2:1:9"}, ["rms(q2)", "mean_force(1)"])

# %%
# Those were the ten lines. What separates two methods is named: differences by averaging are
# reported, all others are judged. The plot has the tails, with two standard errors of the
# simulation.
#
# Every quantity has its value and its error:

print(table.xs("value", axis=1, level=1).round(4).to_string())
print(table.xs("error", axis=1, level=1).to_string(float_format="{:.0e}".format))

# %%
# The labelled arrays of densities and of the sweep, for whatever comes next:

print(data)
rms_of = sweep.to_xarray()["value"].sel(quantity="rms(q2)", route="nonintegrable")
print(rms_of.to_series().round(6).to_string())

# %%
# The energy-averaged rms is within 1 % of the simulated one; averaging the modes, which leaves the
# contacts out, is almost twice too large. The farther the
# stops, the larger the rms.

rms = table.loc[("q2", "rms")]
true = rms["montecarlo", "value"]
print(f"simulated {true:.4f} ± {rms['montecarlo', 'error']:.4f}")
assert rms["montecarlo", "error"] < 1e-3
error = rms["nonintegrable/fem", "value"] / true - 1.0
print(f"energy averaging is off by {100 * error:+.2f} %")
assert 0.003 < -error < 0.01
assert rms["integrable/closed-form", "value"] > 1.85 * true
for row in answers.quantities:  # the same one by one, by names that a sweep takes
    assert row.number.error >= 0.0 and row.name.endswith(")"), row
assert not answers.problems
assert not sweep.problems
assert (rms_of.diff("contact.1.clearance") > 0.0).all()
at_half = float(rms_of.sel({"contact.1.clearance": 0.5}, method="nearest"))
difference = abs(at_half - rms["nonintegrable/fem", "value"])
print(f"at the clearance of the scene the sweep differs by {difference:.0e}")
assert difference <= 2.0 * rms["nonintegrable/fem", "error"] + 1e-15
