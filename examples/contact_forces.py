"""
What a stop feels: contact probability, overlap and force
=========================================================

The share of time in which a mass touches a stop, how deep it goes in, and the mean force follow
from the density of its displacement. Every number has its error.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import quad

import fpk
from fpk.answer.contacts import contact_quantities

stop = fpk.Contact(mass=1, side="right", stiffness=10.0, clearance=0.5)  # force 10 x^1.5
system = fpk.System([1.0], [1.0], [0.1], [0.05], contacts=(stop,))
p = fpk.solve(system, ["q1"], methods=["exact"])["q1"]

for quantity in (p.mean, p.std, p.rms, p.skewness, p.kurtosis):
    print(f"{quantity.__name__:20} {quantity().value:.12f} ± {quantity().error:.1e}")
felt = contact_quantities(stop, p)
for name, number in felt.items():
    print(f"{name:20} {number.value:.12f} ± {number.error:.1e}")

# %%
# A stop on one side makes the density skew.

q = np.linspace(-2.5, 1.2, 371)
figure, axes = plt.subplots()
axes.axvspan(0.5, 1.2, color="0.9")
axes.plot(q, p(q))
axes.fill_between(q, p(q), where=q > 0.5, alpha=0.4, label="in contact")
axes.set(xlabel="$q_1$", ylabel="$p(q_1)$", ylim=(0, None))
axes.legend()

# %%
# Damping in proportion to the noise: :math:`p \propto e^{-2V(q)}` is exact. Adaptive quadrature of
# that gives the same numbers, within the errors that were stated.


def weight(q):
    """Return exp(−(c/D) V(q)), V with the contact energy of the stop."""
    return np.exp(-2.0 * (0.5 * q * q + 4.0 * max(q - 0.5, 0.0) ** 2.5))


def integral(function, start):
    """Return the integral of a function times the weight from ``start`` on."""
    parts = [(start, 0.5), (0.5, 3.0)] if start < 0.5 else [(0.5, 3.0)]
    return sum(
        quad(lambda q: function(q) * weight(q), *ends, epsabs=0, epsrel=1e-12)[0] for ends in parts
    )


mass = integral(lambda q: 1.0, -9.0)
expected = {
    "contact probability": integral(lambda q: 1.0, 0.5) / mass,
    "mean overlap": integral(lambda q: q - 0.5, 0.5) / mass,
    "mean force": integral(lambda q: 10.0 * (q - 0.5) ** 1.5, 0.5) / mass,
}
for name, value in expected.items():
    print(f"{name:20} differs by {abs(felt[name].value - value):.1e}")
    assert abs(felt[name].value - value) <= felt[name].error + 1e-11 * value
# In the mean the stop is pushed back by the spring: mean force = −stiffness · mean displacement.
assert abs(felt["mean force"].value + p.mean().value) <= felt["mean force"].error + p.mean().error
