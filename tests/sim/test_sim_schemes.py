"""Each integrator against a twin of a few lines of NumPy on the same stream of normals."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm
from sim_systems import exact, fig6, linear, mixed, place

from fpk.system.contact import Contact
from fpk.system.contact_law import LAWS, ContactLaw
from fpk.system.system import System
from sim.sample.ensemble import Ensemble
from sim.step.random import normals
from sim.step.schemes import SCHEMES, exact_flow, factored, flow_covariance, lower_trapezoidal

Array = NDArray[np.float64]
Step = Callable[[System, float, Array, Array, Callable[[int], Array]], tuple[Array, Array]]


def contact(system: System, q: Array) -> tuple[Array, Array]:
    g, slope = np.zeros_like(q), np.zeros_like(q)
    for stop in system.stops:
        sign = 1.0 if stop.side == "right" else -1.0
        overlap = np.maximum(sign * q[stop.index] - stop.clearance, 0.0)
        g[stop.index] += sign * stop.force(overlap)
        slope[stop.index] += np.where(overlap > 0, stop.slope(overlap), 0.0)
    return g, slope


def exact_flow_twin(system, h, q, p, draw):
    g, slope = contact(system, q)
    m = system.mass[:, None]
    flow = exact_flow(system, h)
    x = np.vstack([q, p - h * g * (1 - h**2 * slope / (12 * m))])
    x = flow.propagator @ x + lower_trapezoidal(flow.factor) @ draw(flow.factor.shape[1])
    return x[: system.n], x[system.n :]


def baoab_twin(system, h, q, p, draw):
    m, c = system.mass[:, None], system.damping / system.mass
    force = contact(system, q)[0] + system.stiffness_matrix @ q
    p = p - h / 2 * force - h / 2 * force  # the half kicks of two steps: stored before both
    q = q + h / 2 * p / m
    L = lower_trapezoidal(factored(flow_covariance(-c, 2 * system.noise_matrix, h)[1]))
    p = expm(-c * h) @ p + L @ draw(L.shape[1])
    return q + h / 2 * p / m, p


def euler_twin(system, h, q, p, draw):
    m, n = system.mass[:, None], system.n
    force = contact(system, q)[0] + system.stiffness_matrix @ q + system.damping @ (p / m)
    zero = np.zeros((n, n))
    covariance = np.block([[zero, zero], [zero, 2 * h * system.noise_matrix]])
    L = lower_trapezoidal(factored(covariance))[n:]
    return q + h * p / m, p - h * force + L @ draw(L.shape[1])


TWINS: dict[str, Step] = {
    "exact_flow": exact_flow_twin,
    "baoab": baoab_twin,
    "euler_maruyama": euler_twin,
}


FIVE = pytest.param(lambda: linear(5), marks=pytest.mark.slow, id="five")


def assert_kernel_equals_its_twin(name: str, system: System) -> None:
    h, paths, seed = 0.02 if name == "euler_maruyama" else 0.11, 150, 977
    ensemble = Ensemble(system, SCHEMES[name], h, paths, seed, 1)
    q, p = (x.T * 3.0 for x in ensemble.phase_points())
    place(ensemble, 3.0 * ensemble.states)
    for step in range(20):
        pairs = ensemble.step.pairs
        draw = lambda r, s=step, k=pairs: normals(seed, paths, s * k, max(r, 1))[:r]  # noqa: E731
        q, p = TWINS[name](system, h, q, p, draw)
    ensemble.advance(20)
    found = ensemble.phase_points()
    np.testing.assert_allclose(found[0].T, q, rtol=0, atol=1e-12 * np.abs(q).max())
    np.testing.assert_allclose(found[1].T, p, rtol=0, atol=1e-12 * np.abs(p).max())


@pytest.mark.parametrize("make", [fig6, exact, linear, lambda: linear(1), FIVE])
@pytest.mark.parametrize("name", sorted(SCHEMES))
def test_kernel_equals_its_twin(name: str, make: Callable[[], System]) -> None:
    assert_kernel_equals_its_twin(name, make())


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("baoab", "euler_maruyama")]


@pytest.mark.parametrize("name", ["exact_flow", *SLOW])
def test_kernel_of_three_masses_equals_its_twin(name: str) -> None:
    assert_kernel_equals_its_twin(name, mixed())


def test_every_scheme_of_the_folder_has_a_twin() -> None:
    assert set(SCHEMES) == set(TWINS)


def test_a_law_registered_by_someone_else_is_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    cubic = ContactLaw(
        "cubic", 3.0, lambda x, e: x**3, lambda x, e: x**4 / 4, lambda x, e: 3 * x * x
    )
    monkeypatch.setitem(LAWS, cubic.name, cubic)
    contact_with_law = Contact(2, "both", 10.0, 0.5, law="cubic")
    system = System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.1, 0.1], contacts=(contact_with_law,))
    assert_kernel_equals_its_twin("exact_flow", system)
