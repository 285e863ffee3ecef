"""
An exact solution with contact
==============================

Where damping and noise are in proportion, Eq. (8), the stationary density of the full system is
known: :math:`p(q, v) = C \\exp(-(c/D) H)`, Eq. (7). Nothing is averaged, so that every other route
can be judged by it.
"""

import matplotlib.pyplot as plt
import numpy as np

import fpk

stops = (
    fpk.Contact(mass=1, side="left", stiffness=20.0, clearance=0.4),
    fpk.Contact(mass=2, side="both", stiffness=10.0, clearance=0.5),
)
system = fpk.System([1, 2], [1, 3], [0.1, 0.2], [0.02, 0.04], contacts=stops)  # c/D = 5
answers = fpk.solve(system, ["q1,q2"], methods=["exact"])
joint = answers["q1,q2"]

# %%
# The joint density of both displacements, cut by the stops.

q1, q2 = np.linspace(-1.2, 1.5, 121), np.linspace(-1.3, 1.3, 121)
figure, axes = plt.subplots()
picture = axes.contourf(q1, q2, joint(q1[None, :], q2[:, None]), 12, cmap="cividis")
axes.axvline(-0.4, color="w", ls="--")
for clearance in (-0.5, 0.5):
    axes.axhline(clearance, color="w", ls="--")
axes.set(xlabel="$q_1$", ylabel="$q_2$", aspect="equal")
figure.colorbar(picture, label="$p(q_1, q_2)$")

# %%
# :math:`\ln p` differs from :math:`-5 V` by one constant; averaging of the energy is exact, too.

points = np.random.default_rng(7).uniform(-0.8, 0.8, (50, 2))
value, error = joint.at(points[:, 0], points[:, 1])
constant = np.log(value) + 5.0 * system.potential(points)
spread = np.ptp(constant)
print(f"ln p + 5 V varies by {spread:.1e}")
assert spread <= 2.0 * np.max(error / value) + 1e-12

q = np.linspace(-1.2, 1.2, 25)
exact = fpk.solve(system, ["q2"], methods=["exact"])["q2"]
averaged = fpk.solve(system, ["q2"], methods=["nonintegrable/fem"])["q2"]
difference = np.max(np.abs(exact(q) - averaged(q)))
print(f"exact and averaged differ by {difference:.1e}")
assert difference <= np.max(exact.at(q)[1] + averaged.at(q)[1])
