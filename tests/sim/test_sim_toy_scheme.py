"""A scheme of one file: implicit midpoint, whose stationary covariance is exact without contacts.

With A = L h/2 a step is (1 − A) x' = (1 + A) x + noise of covariance 2D h. A covariance P is
stationary if (1 − A) P (1 − A)ᵀ = (1 + A) P (1 + A)ᵀ + 2D h, that is L P + P Lᵀ + 2D = 0 whatever
h is: the equation of the process itself.
"""

from collections.abc import Iterator

import numpy as np
import pytest

from fpk.answer.names import parse_observable
from fpk.system.linear import diffusion_matrix, drift_matrix
from fpk.system.system import System
from sim import MonteCarlo
from sim.step.schemes import SCHEMES, LinearMap, Scheme, factored, register

FREE = System([1.0], [1.0], [0.2], [0.1])
"""σ² of q and v is D/(c k) = ½."""


def midpoint(system: System, dt: float) -> LinearMap:
    """Return (1 − A)⁻¹ (1 + A) and the factor of (1 − A)⁻¹ 2D h (1 − A)⁻ᵀ."""
    half, one = 0.5 * dt * drift_matrix(system), np.eye(2 * system.n)
    back = np.linalg.inv(one - half)
    return LinearMap(back @ (one + half), factored(back @ diffusion_matrix(system) @ back.T * dt))


@pytest.fixture
def toy() -> Iterator[str]:
    register(Scheme(name="midpoint", weak_order=2, linear_map=midpoint))
    yield "midpoint"
    del SCHEMES["midpoint"]


def variances(scheme: str, dt: float) -> dict[str, tuple[float, float]]:
    method = MonteCarlo(scheme=scheme, dt=dt, paths=4096, relaxations=20.0, seed=3)
    result = method.solve(FREE, [parse_observable("q1", 1)])
    moments = result.report.moments  # type: ignore[attr-defined]
    return {name: (m.value, m.error) for name, m in moments.items()}


def test_a_scheme_of_one_file_samples(toy: str) -> None:
    for name in ("q1²", "v1²"):
        mean, error = variances(toy, 0.5)[name]
        assert error < 0.01 and abs(mean - 0.5) < 5.0 * error
        # The control: Euler's rule is off by far more at a fifth of the step.
        mean, error = variances("euler_maruyama", 0.1)[name]
        assert abs(mean - 0.5) > 20.0 * error


def test_it_is_offered_and_a_name_is_taken_once(toy: str) -> None:
    assert MonteCarlo(scheme=toy).scheme == toy
    with pytest.raises(ValueError, match="already"):
        register(SCHEMES[toy])
