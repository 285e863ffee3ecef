"""
Rare failure by splitting
=========================

A failure that one path in ten thousand meets is out of reach of a short simulation. Adaptive
multilevel splitting kills the paths that are farthest from failure and branches the others; its
estimate is unbiased. Here a single linear mode, whose answer is known.
"""

import matplotlib.pyplot as plt
import numpy as np

import fpk
from averaging import NonIntegrable
from fpk.answer.names import REST, parse_limit
from sim.questions.splitting import Splitting, rare_failure

system = fpk.System([1.0], [1.0], [0.05], [0.025])
settings = Splitting(256, repetitions=32, seed=11)
limits, split = (3.0, 4.0, 5.0), []
for value in limits:
    split.append(rare_failure(system, parse_limit(f"H={value}", 1), REST, 40.0, settings=settings))
    print(
        f"P(H passes {value} before t = 40) = {split[-1].probability:.2e} ± {split[-1].error:.0e}"
    )

# %%
# The averaged equation, solved to ten digits, beside them: it is off by its averaging error, some
# per cent here.

energies, failures = np.linspace(2.5, 5.5, 13), []
for value in energies:
    limit = parse_limit(f"H={value}", 1)
    failures.append(NonIntegrable().passage(system, limit, REST, np.array([40.0])).failure[0])
figure, axes = plt.subplots()
axes.semilogy(energies, failures, label="averaged equation")
bars = [2 * s.error for s in split]
axes.errorbar(limits, [s.probability for s in split], bars, fmt="o", label="splitting, full system")
axes.set(xlabel="limit of H", ylabel="P(T ≤ 40)")
axes.legend()

for value, answer in zip(limits, split, strict=True):
    averaged = float(np.exp(np.interp(value, energies, np.log(failures))))
    print(f"H = {value}: splitting {answer.probability:.2e}, averaged {averaged:.2e}")
    # Chance exceeds four standard errors once in 16000; averaging is off by the order of c, 5 %.
    assert abs(answer.probability - averaged) <= 4.0 * answer.error + 0.05 * averaged
