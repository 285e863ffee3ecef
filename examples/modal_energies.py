"""
Modal energies
==============

Averaging of quasi-integrable systems leaves the stops out and gives the energies of the modes:
independent exponentials, Eq. (34), of means :math:`\\theta_i = d_i/c^*_{ii}`.
"""

import matplotlib.pyplot as plt
import numpy as np

import fpk
from averaging import Integrable

system = fpk.System([1.0, 1.0], [1.0, 1.0], [0.08, 0.04], [0.01, 0.02])
closed = fpk.solve(system, ["H1,H2"], methods=["integrable/closed-form"])["H1,H2"]
(elements,) = Integrable("fem", 1e-9).solve(system, [closed.observable]).densities

h1, h2 = np.linspace(0, 0.8, 101), np.linspace(0, 0.5, 101)
figure, axes = plt.subplots()
picture = axes.contourf(h1, h2, elements(h1[None, :], h2[:, None]), 12, cmap="cividis")
axes.set(xlabel="$H_1$", ylabel="$H_2$")
figure.colorbar(picture, label="$p(H_1, H_2)$")

# %%
# The means by hand: modes of the chain, damping and noise in modal coordinates.

_, T = np.linalg.eigh(system.stiffness_matrix)
means = np.diag(T.T @ system.noise_matrix @ T) / np.diag(T.T @ system.damping @ T)
for k, expected in enumerate(means, start=1):
    mean = fpk.solve(system, [f"H{k}"], methods=["integrable"])[f"H{k}"].mean()
    print(f"E H{k} = {mean.value:.12f} ± {mean.error:.0e}, by hand {expected:.12f}")
    assert abs(mean.value - expected) <= mean.error + 1e-13

value, error = elements.at(h1[:, None], h2[None, :])
difference = np.max(np.abs(value - closed(h1[:, None], h2[None, :])))
print(f"elements and closed form differ by {difference:.1e} at most, stated {error.max():.1e}")
assert difference <= np.max(error + closed.at(h1[:, None], h2[None, :])[1])
