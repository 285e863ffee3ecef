"""
One density
===========

A first script: describe the system, solve, evaluate, and see what the answer is worth. The system
is that of Fig. 6(a) of the paper with B = 10; energy averaging, Eq. (24), by finite elements.
"""

import matplotlib.pyplot as plt
import numpy as np

import fpk

stop = fpk.Contact(mass=2, side="both", stiffness=10.0, clearance=0.5)  # masses count from 1
system = fpk.System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02], contacts=(stop,))

answers = fpk.solve(system, ["q2", "H"], methods=["nonintegrable/fem"], tol=1e-8)
p = answers["q2"]
print(p)
print("p(0.3) =", float(p(0.3)))

# %%
# The density, stops as grey walls.

figure, axes = plt.subplots()
x = np.linspace(-1.5, 1.5, 301)
axes.axvspan(0.5, 1.5, color="0.9")
axes.axvspan(-1.5, -0.5, color="0.9")
axes.plot(x, p(x))
axes.set(xlabel="$q_2$", ylabel="$p(q_2)$")

# %%
# The same in one line, with its error; ``log`` shows the tails.

fpk.plot(p, log=True)

# %%
# A density comes with an estimate of its error at every point, and with its certificate.
q = np.linspace(-1.5, 1.5, 31)
value, error = p.at(q)
assert p.certificate.certified
assert p.l1_error <= 1e-8
assert np.all(error <= 1e-8)

# %%
# The averaged equation has a closed form here: the difference lies within the two errors.
closed = fpk.solve(system, ["q2"], methods=["nonintegrable/closed-form"])["q2"]
assert np.all(np.abs(value - closed(q)) <= error + closed.at(q)[1])
difference = np.max(np.abs(value - closed(q)))
print(f"largest error stated {error.max():.1e}, difference to the closed form {difference:.1e}")
