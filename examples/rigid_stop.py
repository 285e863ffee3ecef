"""
Stiffer and stiffer stops
=========================

With the stiffness B of a stop the density approaches that of a rigid one, a Gaussian cut off at the
clearance. The layer in which the stop is felt is as thin as :math:`B^{-2/5}` for Hertz's law, and
so is the distance.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.special import erf

import fpk

clearance = 0.5


def density(stiffness):
    """p(q1) between Hertzian stops of that stiffness."""
    stop = fpk.Contact(1, "both", stiffness, clearance)
    system = fpk.System([1.0], [1.0], [0.1], [0.05], contacts=(stop,))
    return fpk.solve(system, ["q1"], methods=["exact"])["q1"]


q = np.linspace(-1.0, 1.0, 401)
rigid = np.where(np.abs(q) < clearance, np.exp(-q * q) / (np.sqrt(np.pi) * erf(clearance)), 0.0)
figure, axes = plt.subplots()
axes.axvspan(clearance, 1.0, color="0.9")
axes.axvspan(-1.0, -clearance, color="0.9")
for stiffness in (10.0, 1e3, 1e5):
    axes.plot(q, density(stiffness)(q), label=f"B = {stiffness:g}")
axes.plot(q, rigid, "k--", lw=1, label="rigid")
axes.set(xlabel="$q_1$", ylabel="$p(q_1)$")
axes.legend()

# %%
# Half the distance to the rigid stop is the share of time in contact. It falls by
# :math:`10^{-2/5}` with each factor of ten in B.

stiffnesses = 10.0 ** np.arange(4, 13)
shares = [2.0 * density(B).exceedance(clearance).value for B in stiffnesses]
ratios = np.array(shares[1:]) / np.array(shares[:-1])
for B, share, ratio in zip(stiffnesses[1:], shares[1:], ratios, strict=True):
    print(f"B = {B:.0e}: in contact {share:.3e}, ratio {ratio:.5f}, limit {10**-0.4:.5f}")
assert np.all(np.diff(np.abs(ratios - 10**-0.4)) < 0.0)
assert abs(ratios[-1] - 10**-0.4) < 1e-4
