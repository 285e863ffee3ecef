"""Random systems: elements are never farther from the closed form than both errors say."""

from dataclasses import replace

import numpy as np
import pytest

from averaging import NonIntegrable
from fpk import Contact, System
from fpk.answer.names import parse_observable

LAWS = ("hertz", "bilinear", "power")
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)


def random_system(rng: np.random.Generator) -> System:
    """One to twenty masses of one temperature, one or two with stops, some without clearance."""
    n, law = int(rng.choice([1, 1, 2, 3, 5, 20])), str(rng.choice(LAWS))
    exponent = float(rng.uniform(1.0, 4.0)) if law == "power" else None
    contacts = tuple(
        Contact(
            int(mass) + 1,
            str(rng.choice(["both", "left", "right"])),
            10.0 ** rng.uniform(-1.0, 6.0),
            float(rng.choice([0.0, 10.0 ** rng.uniform(-6.0, 0.5)])),
            law,
            exponent,
        )
        for mass in rng.choice(n, int(rng.integers(1, min(n, 2) + 1)), replace=False)
    )
    ones = np.ones(n)
    noise = 0.02 * 10.0 ** rng.uniform(0.0, 0.5)
    return System(ones, rng.uniform(0.5, 2.0, n), 0.1 * ones, noise * ones, contacts=contacts)


@pytest.mark.parametrize(
    "seed", [*range(8), *(pytest.param(k, marks=pytest.mark.slow) for k in range(8, 80))]
)
def test_stated_errors_hold_everywhere(seed: int) -> None:
    rng = np.random.default_rng(seed)
    system, tol = random_system(rng), float(rng.choice(TOLERANCES))
    for name in ("H", f"q{system.contacts[0].mass}"):
        asked = [parse_observable(name, system.n)]
        solved, exact = (
            NonIntegrable(solver, **how).solve(system, asked).densities[0]
            for solver, how in (("fem", {"tol": tol}), ("closed-form", {}))
        )
        # Points of no rule, and close to the ends of panels.
        nodes = solved.panels[0]
        x = np.concatenate([nodes[:-1] + share * np.diff(nodes) for share in (0.03, 0.31, 0.77)])
        (value, error), (expected, own) = solved.at(x), exact.at(x)
        assert np.all(np.isfinite(error)) and np.all(np.abs(value - expected) <= error + own)


def test_stated_errors_do_not_hide_another_system() -> None:
    system = random_system(np.random.default_rng(0))
    other = replace(system, noise_intensity=1.001 * system.noise_intensity)
    asked = [parse_observable("H", system.n)]
    (solved,), (expected,) = (
        NonIntegrable(solver).solve(s, asked).densities
        for solver, s in (("fem", system), ("closed-form", other))
    )
    x = 0.5 * (solved.panels[0][1:] + solved.panels[0][:-1])
    (value, error), (exact, own) = solved.at(x), expected.at(x)
    assert not np.all(np.abs(value - exact) <= error + own)
