"""
From rest to the stationary state
=================================

The density of the energy at times after a start. For one linear mode it is a noncentral
:math:`\\chi^2`, known at all times.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import ncx2

import fpk
from averaging import NonIntegrable
from fpk.answer.names import parse_observable, parse_start

c, D, H0 = 0.1, 0.05, 0.3
system = fpk.System([1.0], [1.0], [c], [D])
energy, times = np.linspace(0.01, 2.5, 250), np.array([1.0, 5.0, 20.0, 80.0])
H, start = parse_observable("H", 1), parse_start(f"H={H0}", system)
answer = NonIntegrable().transient(system, H, start, times, (energy,))

figure, axes = plt.subplots()
for t, values in zip(times, answer.values, strict=True):
    axes.plot(energy, values, label=f"t = {t:g}")
axes.axvline(H0, color="0.7", ls=":")
axes.set(xlabel="H", ylabel="p(H, t)")
axes.legend()

# %%
# With :math:`s = D(1 - e^{-ct})/(2c)`, :math:`H/s` is a :math:`\chi^2` of two degrees of freedom
# and noncentrality :math:`H_0 e^{-ct}/s`.

for t, values, errors in zip(times, answer.values, answer.errors, strict=True):
    s = D * (1 - np.exp(-c * t)) / (2 * c)
    exact = ncx2.pdf(energy / s, 2, H0 * np.exp(-c * t) / s) / s
    difference = np.abs(values - exact)
    print(f"t = {t:4g}: largest difference {difference.max():.1e}, stated {errors.max():.1e}")
    assert np.all(difference <= errors + 1e-12 * exact.max())
assert answer.certificate.certified
