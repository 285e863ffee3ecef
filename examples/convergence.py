"""
Convergence of the elements
===========================

Elements of degree k converge in L1 as :math:`h^{k+1}` with the mesh width h, and the
error is stated with each. Here the mesh is refined by hand; ``fpk converge`` makes the whole study.
"""

import matplotlib.pyplot as plt
import numpy as np

import fpk
from averaging import NonIntegrable
from averaging.energy_process import energy_process
from fpk.answer.density import l1_distance
from fpk.solvers.line.stationary import solve_on_mesh

system = fpk.load("fig6a").system
process = energy_process(system)
closed = fpk.solve(system, ["H"], methods=["nonintegrable/closed-form"])["H"]
contact = process.nonsmooth[0]  # the energy at which the stop is first reached
cells = 2 ** np.arange(2, 7)

figure, axes = plt.subplots()
for degree in (1, 2, 4):
    errors = []
    for n in cells:
        nodes = np.union1d(np.linspace(0, contact, n // 2 + 1), np.linspace(contact, 16, 4 * n))
        solution = solve_on_mesh(process, nodes, degree)
        x, w = np.polynomial.legendre.leggauss(12)
        half = 0.5 * np.diff(nodes)[:, None]
        energy = nodes[:-1, None] + half * (1 + x)
        errors.append(float(np.sum(half * w * np.abs(solution.density(energy) - closed(energy)))))
        assert errors[-1] <= solution.l1_error + closed.l1_error
    axes.loglog(cells, errors, "o-", label=f"degree {degree}")
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    print(f"degree {degree}: errors {', '.join(f'{e:.1e}' for e in errors)}; "
          f"orders {', '.join(f'{o:.2f}' for o in orders)}")  # fmt: skip
    assert abs(orders[-1] - (degree + 1)) < 0.15
axes.set(xlabel="n, cells per range", ylabel="L1 error of $p(H)$")
axes.legend()

# %%
# By itself the program grades the mesh and chooses the degree: the tolerance is all that it needs.

for tol in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10):
    p = fpk.solve(system, ["H"], methods=[NonIntegrable(tol=tol)])["H"]
    true = l1_distance(p, closed)
    print(f"tol {tol:.0e}: stated {p.l1_error:.1e}, true {true:.1e}")
    assert true <= p.l1_error + closed.l1_error <= tol + closed.l1_error
