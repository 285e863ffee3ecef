"""
Without stops: a Gaussian, and the error of both averagings
===========================================================

Without contact the full system is linear and its stationary density a Gaussian, exact for any
damping and noise. Neither averaging gives it in general: what is left is the averaging error.
"""

import matplotlib.pyplot as plt
import numpy as np

import fpk
from fpk.answer.density import l1_distance

system = fpk.System([1, 1, 1], [1, 2, 1], [0.08, 0.04, 0.02], [0.01, 0.02, 0.02])
methods = ["linear", "nonintegrable/closed-form", "integrable/closed-form"]
answers = fpk.solve(system, ["q3"], methods=methods)
gaussian = answers["q3", "linear"]

q = np.linspace(-8, 8, 321)
figure, axes = plt.subplots()
for (_, method), words in zip(
    answers, ("exact", "energy averaging", "modal averaging"), strict=True
):
    axes.plot(q, answers["q3", method](q), label=words)
axes.set(xlabel="$q_3$", ylabel="$p(q_3)$")
axes.legend()

# %%
# The Gaussian has the variance of the Lyapunov equation :math:`AC + CA^T + b = 0`, solved here with
# SciPy.

from scipy.linalg import solve_continuous_lyapunov

drift = np.block([[np.zeros((3, 3)), np.eye(3)], [-system.stiffness_matrix, -system.damping]])
noise = np.zeros((6, 6))
noise[3:, 3:] = 2.0 * system.noise_matrix
covariance = solve_continuous_lyapunov(drift, -noise)
variance = gaussian.variance()
print(f"variance {variance.value:.12f} ± {variance.error:.1e}")
assert abs(variance.value - covariance[2, 2]) <= variance.error + 1e-10 * covariance[2, 2]
assert abs(gaussian.kurtosis().value - 3.0) <= gaussian.kurtosis().error

for name, least, most in (("nonintegrable", 0.05, 0.5), ("integrable", 0.0, 0.02)):
    distance = l1_distance(gaussian, answers["q3", f"{name}/closed-form"])
    print(f"averaging error of {name:14} {distance:.4f}")
    assert least <= distance <= most
