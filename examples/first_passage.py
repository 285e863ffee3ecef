"""
First passage and reliability
=============================

When does the energy first pass a limit? The mean time, its variance, the failure rate and the
reliability P(T > t) follow from the averaged equation with an absorbing end.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.special import expi

import fpk
from averaging import NonIntegrable
from fpk.answer.names import REST, parse_limit

times = np.linspace(1.0, 200.0, 100)
stop = fpk.Contact(mass=2, side="both", stiffness=10.0, clearance=0.5)
figure, axes = plt.subplots()
for contacts, words in (((stop,), "stops of B = 10"), ((), "without stops")):
    system = fpk.System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02], contacts=contacts)
    answer = NonIntegrable().passage(system, parse_limit("H=1", 2), REST, times)
    print(f"{words}: mean {answer.mean.value:.9f} ± {answer.mean.error:.0e}, "
          f"rate {answer.rate.value:.9f} ± {answer.rate.error:.0e}")  # fmt: skip
    axes.plot(times, answer.survival, label=words)
    assert answer.certificate.certified
axes.set(xlabel="t", ylabel="P(T > t)", ylim=(0, 1))
axes.legend()

# %%
# One mass without stops: the mean time from rest is :math:`(\mathrm{Ei}(x) - \ln x - \gamma)/c`
# with :math:`x = c H_f/D`, also where it is longer than the age of anything.

c, D = 0.1, 0.05
one = fpk.System([1.0], [1.0], [c], [D])
for limit in (0.5, 1.5, 10.0, 100.0):
    mean = NonIntegrable().passage(one, parse_limit(f"H={limit}", 1), REST, times).mean
    x = c * limit / D
    exact = (expi(x) - np.log(x) - np.euler_gamma) / c
    off = abs(mean.value - exact)
    print(f"H = {limit:5}: mean {mean.value:.12e}, relative error {off / exact:.0e}")
    assert off <= mean.error + 1e-14 * exact  # the formula in double precision is off, too
