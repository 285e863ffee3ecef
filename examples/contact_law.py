"""
A contact law of your own
=========================

A law is one record: force, its integral and its derivative, at unit stiffness, Eq. (2). Once
registered it is known everywhere, in scene files too.
"""

import matplotlib.pyplot as plt
import numpy as np

import fpk
from fpk.system.contact_law import ContactLaw, register_law

register_law(
    ContactLaw(
        "cubic",
        exponent=3.0,
        force=lambda x, e: x * x * x,
        energy=lambda x, e: 0.25 * x * x * x * x,
        slope=lambda x, e: 3.0 * x * x,
    )
)


def density(law, exponent=None):
    """p(q1) of an oscillator between stops of that law."""
    stop = fpk.Contact(1, "both", 10.0, 0.2, law, exponent)
    system = fpk.System([1.0], [1.0], [0.1], [0.05], contacts=(stop,))
    return fpk.solve(system, ["q1"], methods=["exact"])["q1"]


# The same as the power law with that exponent.
q = np.linspace(-1.0, 1.0, 21)
own, power = density("cubic"), density("power", 3.0)
assert np.all(np.abs(own(q) - power(q)) <= own.at(q)[1] + power.at(q)[1])
assert own.certificate.certified
print(f"largest difference {np.max(np.abs(own(q) - power(q))):.1e}")

# %%
# The density between stops of the new law, beside that between Hertzian ones.

x = np.linspace(-1.5, 1.5, 301)
figure, axes = plt.subplots()
axes.axvspan(0.2, 1.5, color="0.9")
axes.axvspan(-1.5, -0.2, color="0.9")
axes.plot(x, own(x), label="cubic")
axes.plot(x, density("hertz")(x), "--", label="Hertz")
axes.set(xlabel="$q_1$", ylabel="$p(q_1)$")
axes.legend()
