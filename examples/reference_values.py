"""
Reference values for a solver of your own
=========================================

A neural network, finite differences, a particle method: whatever solves the same equation can be
judged by values whose errors are known. Here are drift and diffusion of the averaged equation (24),
its density with an error at every point, and a file for other programs.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import cumulative_trapezoid

import fpk
from averaging.energy_process import energy_process

system = fpk.load("fig6a").system
p = fpk.solve(system, ["H"], methods=["nonintegrable/fem"], tol=1e-10)["H"]
H = np.linspace(0.005, 4.0, 800)
value, error = p.at(H)
coefficients = energy_process(system).coefficients(H)
s, b = coefficients.drift, coefficients.diffusion  # dH = s dt + √b dB, Ito

with TemporaryDirectory() as folder:
    path = Path(folder) / "reference.csv"
    table = np.column_stack([H, s, b, value, error])
    np.savetxt(path, table, "%.17g", delimiter=",", header="H,s,b,p,error", comments="")
    print("".join(path.read_text().splitlines(keepends=True)[:4]))
    again = np.loadtxt(path, delimiter=",", skiprows=1)
assert np.array_equal(again, table)

# %%
# "A solver of your own" on the same equation, in one line: zero flux by the trapezoidal rule on the
# grid of the table. Its error is known at every point, the reference's own is far below it.

own = np.exp(cumulative_trapezoid(2.0 * s / b, H, initial=0.0)) / b
own /= np.trapezoid(own, H)
wrong = np.abs(own - value)

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
left.plot(H, value, label="reference")
left.plot(H, own, "--", label="your own")
left.set(xlabel="H", ylabel="p(H)")
left.legend()
right.semilogy(H, wrong, H, np.maximum(error, 1e-18))
right.set(xlabel="H", ylabel="error of yours, and of the reference")

l1 = np.trapezoid(wrong, H)
print(f"your solver: L1 error {l1:.1e}; reference: {p.l1_error:.0e} stated")
assert p.certificate.certified
assert 100.0 * p.l1_error < l1 < 0.05

# %%
# The table satisfies the equation: zero flux means that ln(b p) has the slope 2 s/b. Differences of
# neighbouring points say so up to an error that falls with the step. (Near 0 the slope is n/H,
# which differences do not resolve.)

residuals = []
for every in (2, 1):
    x, log_bp, drift = (f[H > 0.2][::every] for f in (H, np.log(b * value), 2.0 * s / b))
    slope = np.diff(log_bp) / np.diff(x)
    residuals.append(float(np.max(np.abs(slope - 0.5 * (drift[1:] + drift[:-1])))))
print("largest residual with half of the points {:.1e}, with all {:.1e}".format(*residuals))
assert residuals[1] < 0.5 * residuals[0]

# %%
# The *full* equation on a grid: p(q2, p2) by ``phase-space``, with an error at every point. A
# solver in (q, v) takes p(q, v) = m p(q, m v), as p2 = m2 v2.

full = fpk.solve(system, ["q2,p2"], methods=["phase-space"], tol=1e-2)["q2,p2"]
q, v = np.linspace(-1.2, 1.2, 121), np.linspace(-2.0, 2.0, 101)
m = float(system.mass[1])
joint, joint_error = full.at(q[:, None], m * v)

figure, axes = plt.subplots(layout="constrained")
levels = axes.contourf(q, v, m * joint.T, 12)
axes.set(xlabel="q2", ylabel="v2")
figure.colorbar(levels, label="p(q2, v2) of the full equation")

print(f"largest value {m * joint.max():.4f}, largest error on the grid {m * joint_error.max():.0e}")
print(f"L1 error stated: {full.l1_error:.0e}")
assert full.certificate.certified
# The chain has the same stop on both sides: p(−q, −p) = p(q, p).
assert np.all(np.abs(joint - joint[::-1, ::-1]) <= joint_error + joint_error[::-1, ::-1])
