"""py-pde: stepped in time until nothing changes, as it has no steady solver.

Once in flux form, −div J with J = 0 at the walls, and once as its examples write an equation, term
by term in one expression with a vanishing normal derivative on every side. W3 is not asked of it:
it gets no further in W2.
"""

from functools import partial

from installed import need
from measure import Setting, cells, measure_all  # first: NumPy then has one thread

# isort: split

import numpy as np
from problems import PROBLEMS

pde = need("pde")

LINE_END, PLANE_END = 6.0, 14.0
TIME = {"flux form": 100.0, "expression": 20.0}
"""Time from the start: the slowest mode of W2 decays as exp(−0.05 t), that of W1 faster. The
expression shows what it does to the mass much sooner."""
TOLERANCE = 1e-6


def solved(problem, count, form):
    """Return the edges of the cells along each axis and p_h, of whatever mass it has then."""
    ends = [LINE_END] if problem.dimension == 1 else PLANE_END * problem.temperature
    edges = [np.linspace(0.0, end, count + 1) for end in ends]
    grid = pde.CartesianGrid([[0.0, end] for end in ends], [count] * problem.dimension)
    at = np.moveaxis(grid.cell_coords, -1, 0)
    s, b, _ = (
        np.reshape(a, at.shape)
        for a in problem.coefficients(at[0] if problem.dimension == 1 else at)
    )
    scale = np.array([0.4] if problem.dimension == 1 else problem.temperature)
    start = np.exp(-np.tensordot(1.0 / scale, at, 1))
    p = pde.ScalarField(grid, start / (start.sum() * np.prod([e[1] for e in edges])))
    equation = FluxForm(s, b) if form == "flux form" else expanded(grid, s, b)
    solver = pde.ScipySolver(equation, method="LSODA", rtol=TOLERANCE, atol=TOLERANCE)
    if problem.dimension == 2:
        solver = pde.ScipySolver(equation, method="RK23", rtol=1e-4, atol=1e-6)
    controller = pde.Controller(solver, t_range=TIME[form], tracker=None)
    return edges, controller.run(p).data


class FluxForm(pde.PDEBase):
    """∂p/∂t = −div J, J_i = s_i p − ½ ∂(b_i p)/∂H_i, no flux through the walls."""

    def __init__(self, drift, diffusion):
        """Keep the coefficients at the middles of the cells."""
        super().__init__()
        self.drift, self.diffusion = drift, diffusion

    def evolution_rate(self, state, t=0):
        """Return ∂p/∂t."""
        flux = pde.VectorField(state.grid, self.drift * state.data)
        for i, diffusion in enumerate(self.diffusion):
            half = pde.ScalarField(state.grid, 0.5 * diffusion * state.data)
            flux.data[i] -= half.gradient("auto_periodic_neumann").data[i]
        return -flux.divergence({"value": 0.0})


def expanded(grid, drift, diffusion):
    """Return Σ ½ ∂²(b_i p)/∂H_i² − ∂(s_i p)/∂H_i as an expression."""
    axes = grid.axes
    terms, constants = [], {}
    for i, axis in enumerate(axes):
        terms.append(f"d2_d{axis}2(b{i} * p) - d_d{axis}(s{i} * p)")
        constants |= {f"b{i}": pde.ScalarField(grid, 0.5 * diffusion[i])}
        constants |= {f"s{i}": pde.ScalarField(grid, drift[i])}
    return pde.PDE({"p": " + ".join(terms)}, consts=constants, bc={"derivative": 0.0})


def setting(name, count, form):
    """Return one measurement."""
    problem = PROBLEMS[name]
    unit = " an axis" if problem.dimension == 2 else ""
    return Setting(
        name, f"{form}, {count} cells{unit}, t = {TIME[form]:g}",
        partial(solved, problem, count, form),
        lambda answer: cells(*answer), lambda answer: answer[1].size,
        compiles=True,
    )  # fmt: skip


if __name__ == "__main__":
    settings = [setting("W1", count, "flux form") for count in (64, 192)]
    settings += [setting("W1", 32, "expression")]
    settings += [setting("W2", count, "flux form") for count in (24, 48)]
    measure_all("py-pde", "py-pde", settings)
