"""
Many masses
===========

Energy averaging costs no more for ten masses than for two: masses that touch nothing are integrated
out exactly, so that one quadrature is left for one mass between stops.
"""

import matplotlib.pyplot as plt
import numpy as np

import fpk
from fpk.answer.density import l1_distance

figure, axes = plt.subplots()
for n in (1, 2, 5, 10, 30):
    stop = fpk.Contact(mass=n, side="both", stiffness=10.0, clearance=0.5)
    ones = np.ones(n)
    system = fpk.System(ones, n * ones, 0.1 * ones, 0.05 * ones, contacts=(stop,))
    methods = ["exact", "nonintegrable/fem"]
    answers = fpk.solve(system, [f"q{n}"], methods=methods)
    exact, elements = answers[f"q{n}", "exact"], answers[f"q{n}", "nonintegrable/fem"]
    q = np.linspace(-1.2, 1.2, 241)
    axes.plot(q, elements(q), label=f"{n} masses" if n > 1 else "one mass")

    # Damping in proportion to the noise: averaging is exact for any number of masses.
    distance, stated = l1_distance(exact, elements), exact.l1_error + elements.l1_error
    print(f"{n:2} masses: L1 to the exact density {distance:.1e}, stated {stated:.1e}")
    assert elements.certificate.certified
    assert distance <= stated + 1e-14
axes.axvspan(0.5, 1.2, color="0.9")
axes.axvspan(-1.2, -0.5, color="0.9")
axes.set(xlabel="displacement of the last mass", ylabel="density")
axes.legend()
