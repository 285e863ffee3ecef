"""
Tail probabilities
==================

How likely is a displacement far beyond the stops? The relative digits of a density are kept where
it is small, so that probabilities of 1e-12 and quantiles far out are answers, with errors.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import quad

import fpk

stop = fpk.Contact(mass=1, side="both", stiffness=10.0, clearance=0.5)
system = fpk.System([1.0], [1.0], [0.1], [0.05], contacts=(stop,))
p = fpk.solve(system, ["q1"], methods=["exact"])["q1"]
free = fpk.solve(fpk.System([1.0], [1.0], [0.1], [0.05]), ["q1"], methods=["linear"])["q1"]

q = np.linspace(0.0, 2.4, 241)
figure, axes = plt.subplots()
axes.axvspan(0.5, 2.4, color="0.9")
axes.semilogy(q, p(q), label="with stops")
axes.semilogy(q, free(q), "--", label="without")
axes.set(xlabel="$q_1$", ylabel="$p(q_1)$", ylim=(1e-25, 2))
axes.legend()

# %%
# :math:`P(q_1 > x)` against adaptive quadrature of the exact density, and back by quantiles.


def weight(q):
    """Return exp(−(c/D) V(q))."""
    return np.exp(-2.0 * (0.5 * q * q + 4.0 * max(q - 0.5, 0.0) ** 2.5))


mass = 2.0 * sum(quad(weight, *ends, epsabs=0, epsrel=1e-13)[0] for ends in ((0, 0.5), (0.5, 3)))
for x in (0.5, 1.0, 1.5, 2.0):
    given = p.exceedance(x)
    expected = quad(weight, x, x + 1.5, epsabs=0, epsrel=1e-12, limit=200)[0] / mass
    print(f"P(q1 > {x:3}) = {given.value:.10e} ± {given.error:.0e}, off by "
          f"{abs(given.value - expected):.0e}")  # fmt: skip
    assert abs(given.value - expected) <= given.error + 1e-11 * expected
    assert abs(given.value / expected - 1.0) <= 1e-6  # relative digits, in the tail too

x = p.quantile(1.0 - 1e-6)
print(f"exceeded with probability 1e-6: {x.value:.10f} ± {x.error:.0e}")
back = p.exceedance(x.value)
assert abs(back.value - 1e-6) <= back.error + 1e-12
