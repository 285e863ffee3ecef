"""One density: describe the system, solve, evaluate, and look at what it is worth."""

import numpy as np

import fpk

stop = fpk.Contact(mass=2, side="both", stiffness=10.0, clearance=0.5)  # masses count from 1
system = fpk.System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02], contacts=(stop,))

answers = fpk.solve(system, ["q2", "H"], methods=["nonintegrable/fem"], tol=1e-8)
p = answers["q2"]
print(p)
print("p(0.3) =", float(p(0.3)))

# A density comes with an estimate of its error at every point, and with its certificate.
q = np.linspace(-1.5, 1.5, 31)
value, error = p.at(q)
assert p.certificate.certified
assert p.l1_error <= 1e-8
assert np.all(error <= 1e-8)

# The averaged equation has a closed form here: the difference lies within the two errors.
closed = fpk.solve(system, ["q2"], methods=["nonintegrable/closed-form"])["q2"]
assert np.all(np.abs(value - closed(q)) <= error + closed.at(q)[1])
