"""
Level crossings and power spectra
=================================

How often a displacement rises through a level, and at which frequencies it moves. Stops make high
levels rare and raise the frequency.
"""

import matplotlib.pyplot as plt
import numpy as np

import fpk
from averaging import Exact, Linear, PhaseSpace
from fpk.answer.names import parse_observable

stop = fpk.Contact(mass=1, side="both", stiffness=4.0, clearance=0.5)
between_stops = fpk.System([1.0], [1.0], [0.6], [0.3], contacts=(stop,))
free = fpk.System([1.0], [1.0], [0.6], [0.3])
q1 = parse_observable("q1", 1)
levels, frequencies = np.linspace(0.0, 1.5, 61), np.linspace(0.0, 4.0, 81)

crossings = Exact().crossings(between_stops, q1, levels)
rice = Linear().crossings(free, q1, levels)
spectrum = PhaseSpace().spectrum(between_stops, q1, frequencies)
peak = Linear().spectrum(free, q1, frequencies)

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
left.axvspan(0.5, 1.5, color="0.9")
for curve, words in ((crossings, "with stops"), (rice, "without")):
    left.plot(levels, curve.values, label=words)
left.set(xlabel="level of $q_1$", ylabel="upcrossings per unit time")
left.legend()
right.plot(frequencies, spectrum.values, frequencies, peak.values)
right.set(xlabel="angular frequency", ylabel="power spectral density")

# %%
# Rice's formula :math:`\sigma_v/(2\pi\sigma_q)\,e^{-a^2/2\sigma_q^2}` without stops. With stops
# :math:`p(q, v)` is a product, and the rate that at 0 times :math:`e^{-2V(a)}`.

exact = np.exp(-(levels**2)) / (2 * np.pi)
print(f"without stops: off by {np.max(np.abs(rice.values - exact)):.0e}")
assert np.all(np.abs(rice.values - exact) <= rice.errors + 1e-14)
potential = between_stops.potential(levels[:, None])
exact = crossings.values[0] * np.exp(-2.0 * potential)
print(f"with stops: off by {np.max(np.abs(crossings.values - exact)):.0e}")
assert np.all(np.abs(crossings.values - exact) <= crossings.errors + crossings.errors[0])

response = 1.0 / np.abs(1.0 - frequencies**2 + 0.6j * frequencies) ** 2
difference = np.max(np.abs(peak.values / (0.3 / np.pi * response) - 1.0))
print(f"spectrum without stops: relative difference {difference:.0e}")
assert difference < 1e-10
# The spectrum integrates to the variance, half of it at negative frequencies. Beyond the last
# frequency it falls as D/(π ω⁴), up to terms that are less by ω².
total, beyond = 2.0 * np.trapezoid(spectrum.values, frequencies), 2.0 * 0.3 / (3.0 * np.pi * 4.0**3)
variance = fpk.solve(between_stops, ["q1"], methods=["exact"])["q1"].variance().value
print(f"integral of the spectrum {total:.5f} + {beyond:.5f}, variance {variance:.5f}")
assert abs(total + beyond - variance) <= 0.5 * beyond

# %%
# How fast is the past forgotten? The eigenvalues of the FPK operator with the least real parts: one
# mass without stops has :math:`c/2 \pm i\omega`, here :math:`0.3 \pm 0.954 i`.

rates = Linear().relaxation(free, 1)
stopped = PhaseSpace().relaxation(between_stops, 1)
print(f"without stops {rates.values[0]:.6f}, with stops {stopped.values[0]:.4f}")
assert abs(rates.values[0] - complex(0.3, np.sqrt(1.0 - 0.3**2))) <= rates.errors[0] + 1e-14
assert stopped.certificate.certified
