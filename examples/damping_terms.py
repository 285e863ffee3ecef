"""
Damping that depends on the state
=================================

A van der Pol oscillator between stops: energy is fed in near rest and taken out far from it.
"""

import matplotlib.pyplot as plt
import numpy as np

import fpk

term = fpk.DampingTerm(1, 1, 0.4, q=((1, 2),))  # c = −0.1 + 0.4 q²
stop = fpk.Contact(mass=1, side="both", stiffness=20.0, clearance=1.0)
system = fpk.System([1.0], [1.0], [-0.1], [0.005], contacts=(stop,), damping_terms=(term,))

p = fpk.solve(system, ["q1"], methods=["nonintegrable/fem"], tol=1e-6)["q1"]
assert p.certificate.certified

# The limit cycle makes two peaks, mirror images of each other.
q = np.linspace(0.0, 1.2, 121)
value, error = p.at(q)
assert np.all(np.abs(value - p(-q)) <= 2.0 * error + 1e-12)
assert value.max() > 1.2 * value[0]

print(f"p(0) = {value[0]:.6f}, largest {value.max():.6f}, largest error {error.max():.0e}")

x = np.linspace(-1.4, 1.4, 281)
figure, axes = plt.subplots()
axes.axvspan(1.0, 1.4, color="0.9")
axes.axvspan(-1.4, -1.0, color="0.9")
axes.plot(x, p(x))
axes.set(xlabel="$q_1$", ylabel="$p(q_1)$")

# %%
# Without the term the energy grows for ever, and the system says so in one line.
try:
    fpk.System([1.0], [1.0], [-0.1], [0.005])
except fpk.InvalidInput as reason:
    print(reason)
else:
    raise AssertionError("a system that does not dissipate was accepted")
