"""Piecewise polynomials of shell integrals over two contact masses.

One energy takes milliseconds, and a solver asks for thousands. Between contact energies
the integrals are smooth: a panel is fitted once as many energies are asked for as a fit needs.
"""

from collections.abc import Callable

import numpy as np

from averaging.shell.energy_shell import EnergyShell
from fpk.arrays import Array, Integers
from fpk.piecewise import Piecewise, fit
from fpk.quadrature import panel_rule

GRADING = 0.2
"""Panels shrink towards each contact energy from above, where (H − H_c)³ or rougher terms begin."""
DOUBLINGS = 60
"""Panels above the highest contact energy, each twice as long as the one below it."""


POINTS = 16
"""Gauss points of a panel."""
LAYERS = 5
"""Panels towards a contact energy."""
TARGET = 1e-11
"""Last Legendre coefficients of a panel, relative to the largest, above which it is split."""
MOST_SPLITS = 8
"""Splits of a panel at most: each leaves a fifth of it next to a contact energy."""


class ShellTable:
    """Function of the energy by panels that are fitted on demand.

    ``evaluate`` returns (energies, quantities) above the first contact energy of ``shell``:
    relative quantities of order one and, in the columns ``errors``, errors of them. Panels end at
    each contact energy.
    """

    def __init__(
        self, evaluate: Callable[[Array], Array], shell: EnergyShell, errors: Integers
    ) -> None:
        """Lay out the panels; none is fitted yet."""
        self.evaluate, self.errors, breaks = evaluate, errors, shell.contact_energies
        ends = np.array([*breaks, 2.0 * breaks[-1] if breaks[-1] > 0 else 1.0])
        layers = GRADING ** np.arange(1.0, LAYERS + 1.0)
        towards = ends[:-1, None] + np.diff(ends)[:, None] * layers
        beyond = ends[-1] * 2.0 ** np.arange(DOUBLINGS)
        self.edges = np.unique(np.concatenate([breaks, towards.ravel(), beyond]))
        self.panels: dict[int, Piecewise] = {}
        self.single: dict[float, Array] = {}

    def __call__(self, energy: Array) -> Array:
        """Values and errors, as ``evaluate`` returns them, at energies (energies,)."""
        index = np.searchsorted(self.edges, energy, side="right") - 1
        used, count = np.unique(index, return_counts=True)
        for k in used[count >= POINTS].tolist():
            if k not in self.panels:
                self.panels[k] = self._fitted(self.edges[k : k + 2])
        fitted = [k for k in used.tolist() if k in self.panels]
        values = [(index == k, self.panels[k](energy[index == k])) for k in fitted]
        single = ~np.isin(index, fitted)
        if single.any():
            values.append((single, self._each(energy[single])))
        result = np.empty((energy.size, values[0][1].shape[1]))
        for here, rows in values:
            result[here] = rows
        return result

    def _each(self, energy: Array) -> Array:
        """Values at single energies, remembered: solvers begin by asking for the same ones."""
        new = np.array([H for H in energy if float(H) not in self.single])
        if new.size:
            self.single |= zip(map(float, new), self.evaluate(new), strict=True)
        return np.array([self.single[float(H)] for H in energy])

    def _fitted(self, ends: Array) -> Piecewise:
        """The fit between two edges, with a constant bound of the error on each of its panels."""

        def last_two(lengths: Array, c: Array) -> Array:
            return np.asarray(np.abs(np.delete(c[:, -2:], self.errors, axis=2)).max(axis=(1, 2)))

        values = fit(
            self.evaluate,
            ends,
            TARGET,
            degree=POINTS - 1,
            cut=lambda left, right: left + GRADING * (right - left),
            estimate=last_two,
            rounds=MOST_SPLITS,
        )
        assert values.error is not None
        # The fit goes through what was evaluated at the Gauss points.
        largest = values(panel_rule(values.nodes, POINTS)[0])[..., self.errors].max(axis=1)
        values.coefficients[:, :, self.errors] = 0.0
        values.coefficients[:, 0, self.errors] = 2.0 * values.error[:, None] + largest
        return values
