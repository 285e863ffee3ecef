"""
A parameter varied
==================

How far may a stop stand off? ``fpk.sweep`` varies any number of a system, here the clearance, and
gives quantities by several methods. On the command line::

    fpk sweep fig3a --vary "contact[1].clearance=0.1:1.2:12" --quantity "rms(q2)" --out out/sweep
"""

import matplotlib.pyplot as plt
import numpy as np

import fpk

scene = fpk.load("fig3a")  # condition (8) holds: the exact density judges
result = fpk.sweep(
    scene,
    {"contact[1].clearance": np.linspace(0.1, 1.2, 12)},
    ["rms(q2)", "mean_force(1)", "upcrossing_rate(1)"],  # the last: impacts per unit time
    methods=["exact", "nonintegrable", "integrable"],
)
data = result.to_xarray()

# %%
# Each value has its error, drawn as a bar where it can be seen. Averaging of the modal energies
# leaves the stops out: its displacement does not know of the clearance.

figure, panels = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
for axes, quantity in zip(panels, data["quantity"].values, strict=True):
    for route, style in (("exact", "-"), ("nonintegrable", "o"), ("integrable", "--")):
        one = data.sel(quantity=quantity, route=route)
        axes.errorbar(
            one["contact.1.clearance"], one["value"], one["error"], fmt=style, label=route
        )
    axes.set(title=quantity, xlabel="clearance")
panels[0].legend()

# %%
# Where (8) holds, averaging of one energy is exact: what is left is numerical error.

value, error = (data[key].sel(route=["exact", "nonintegrable"]) for key in ("value", "error"))
difference = abs(value.sel(route="exact") - value.sel(route="nonintegrable"))
print(f"largest difference {float(difference.max()):.1e}")
assert np.all(difference <= error.sum("route"))

rms = data["value"].sel(quantity="rms(q2)", route="integrable").values
print(f"without stops the rms is {rms[0]:.4f}")
assert np.ptp(rms) == 0.0
