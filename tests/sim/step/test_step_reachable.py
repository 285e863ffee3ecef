"""Steps that are unstable end a simulation in one line, by every scheme and every reader."""

import numpy as np
import pytest
from sim_systems import transient

from fpk.answer.names import REST, parse_limit, parse_observable
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.system.contact import Contact
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.step.schemes import SCHEMES
from sim.step.step_size import hottest, stability_limit

Q = parse_observable("q1", 1)


def hertz(**fields) -> System:
    """One mass between Hertz stops; at 5 kT they are six times as stiff as the spring."""
    stop = Contact(1, "both", 4.0, 0.5, law="hertz")
    return System([1.0], [1.0], [0.6], [0.3], contacts=(stop,), **fields)


def small(**fields) -> MonteCarlo:
    return MonteCarlo(**{"paths": 4096, "relaxations": 10.0, **fields})


@pytest.mark.parametrize(
    ("scheme", "dt", "least"), [("euler_maruyama", 0.1, 0.6), ("exact_flow", 1.5, 0.8253)]
)
def test_an_unstable_step_ends_in_one_line(scheme: str, dt: float, least: float) -> None:
    """A step beyond the limit, 2 ζ/ω = c/k without contact, 2/ω in contact, is refused."""
    limit = stability_limit(hertz(), SCHEMES[scheme])
    with pytest.raises(InvalidInput, match=f"stability limit {least}"):
        small(scheme=scheme, dt=1.001 * least).solve(hertz(), [Q])
    with pytest.raises(NotCertified, match="unstable; use a dt below") as end:
        small(scheme=scheme, dt=dt, allow_unstable=True, relaxations=150.0).solve(hertz(), [Q])
    assert float(str(end.value).rsplit(maxsplit=1)[1]) <= min(1.01 * limit, 0.5 * dt)


def test_the_stable_step_of_eulers_rule_is_that_of_its_eigenvalues() -> None:
    system = System([2.0, 1.0], [3.0, 1.0], [0.3, 0.2], [0.1, 0.1])
    limit = stability_limit(system, SCHEMES["euler_maruyama"])

    def radius(h: float) -> float:
        step = SCHEMES["euler_maruyama"].linear_map(system, h).propagator
        return float(np.max(np.abs(np.linalg.eigvals(step))))

    assert radius(0.999 * limit) < 1.0 < radius(1.001 * limit)


def test_a_biased_step_below_the_limit_is_not_certified() -> None:
    result = small(scheme="euler_maruyama", dt=0.01, relaxations=40.0).solve(hertz(), [Q])
    assert any("standard errors" in f for f in result.densities[0].certificate.failures)


@pytest.mark.parametrize("question", ["passage", "transient", "crossings", "correlation"])
def test_motions_in_time_end_in_one_line(question: str) -> None:
    at, times = np.array([0.2]), np.array([40.0])
    own = small(dt=1.5, allow_unstable=True, time=40.0)
    asked = {"passage": (parse_limit("q1=9", 1), REST, times), "transient": (Q, REST, times, (at,))}
    words = "are unstable; use a dt below|no step of 1.5 begins in the start; use a smaller dt"
    with pytest.raises((NotCertified, NotApplicable), match=words):
        getattr(own, question)(hertz(), *asked.get(question, (Q, at)))


def test_a_mass_that_is_hotter_than_the_others_stays_within() -> None:
    """Noise on a mass that is hardly damped: T is 500 times the mean that kT is."""
    system = System([1.0, 1.0], [1.0, 1.0], [1.0, 1e-3], [0.0, 1e-3])
    assert hottest(system) == pytest.approx(1.0)
    own = small(dt=0.5, time=50.0, burn_in=2.0)
    assert own.solve(system, [parse_observable("q2", 2)]).identities


def test_motions_without_damping_or_from_far_stay_within() -> None:
    own = small(most_steps=4000)
    far = transient(hertz(), "q1", "q1=6", [0.5, 3.0], [0.0], method=own)
    assert np.all(np.isfinite(far.values))
    loose = System([1.0], [1e-4], [0.0], [0.5])
    grown = transient(loose, "q1", "rest", [100.0], [0.0], method=own)
    # Var q = (2/3) D t³ but for the soft spring, which takes a tenth of it.
    assert grown.values[0, 0] == pytest.approx((2 * np.pi * 2 / 3 * 0.5 * 1e6) ** -0.5, rel=0.3)
