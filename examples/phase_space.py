"""
The full equation without sampling, against sampling
====================================================

For up to three masses with stops on one of them the equation of the full system, Eq. (6), is solved
in phase space by an expansion in Hermite functions. It judges the simulation, and says what
averaging costs.
"""

import matplotlib.pyplot as plt
import numpy as np

import fpk
from averaging import PhaseSpace
from fpk.answer.density import l1_distance
from sim import MonteCarlo

stop = fpk.Contact(mass=2, side="both", stiffness=2.0, clearance=0.5)
system = fpk.System([1, 1], [1, 1], [0.4, 0.2], [0.05, 0.1], contacts=(stop,))
methods = [PhaseSpace(tol=1e-2), MonteCarlo(relaxations=20.0), "nonintegrable/closed-form"]
answers = fpk.solve(system, ["q2", "q2,p2", "p1", "p2"], methods=methods)
solved, sampled = answers["q2", "phase-space"], answers["q2", "montecarlo"]
joint = answers["q2,p2", "phase-space"]

# %%
# The joint density of displacement and momentum, stops as white lines.

q, p = np.linspace(-1.2, 1.2, 97), np.linspace(-1.5, 1.5, 121)
figure, axes = plt.subplots()
picture = axes.contourf(q, p, joint(q[None, :], p[:, None]), 12, cmap="cividis")
for clearance in (-0.5, 0.5):
    axes.axvline(clearance, color="w", ls="--")
axes.set(xlabel="$q_2$", ylabel="$p_2$")
figure.colorbar(picture, label="$p(q_2, p_2)$")

# %%
# Simulation and solution differ by chance; the averaged density by more than that.

for c in fpk.compare(answers):
    if c.observable == "q2":
        band = "reported" if c.band is None else f"allowed {c.band:.2e}"
        print(f"{c.a.label:26} {c.b.label:26} {c.measures:9} L1 = {c.L1:.2e}, {band}")
        assert c.holds
averaging = l1_distance(solved, answers["q2", "nonintegrable/closed-form"])
print(f"averaging error {averaging:.5f} ± {solved.l1_error:.0e}")
assert averaging > 10.0 * solved.l1_error
assert solved.certificate.certified

# %%
# In the mean damping takes out the power that the noise feeds in,
# :math:`\sum c_i\,\mathrm{E}\,v_i^2 = \sum D_i`, stops or none.

squares = [answers[of, "phase-space"].moment(2) for of in ("p1", "p2")]
power = 0.4 * squares[0].value + 0.2 * squares[1].value
error = 0.4 * squares[0].error + 0.2 * squares[1].error
print(f"power of the damping {power:.6f} ± {error:.0e}, of the noise 0.15")
assert abs(power - 0.15) <= error < 0.01 * 0.15
