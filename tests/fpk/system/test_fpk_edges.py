"""Feller classes of the edges of two energies, against square-root processes of known class."""

from dataclasses import replace

import numpy as np
import pytest
from processes import process_of

from fpk.system.ends import classify
from fpk.system.process import Process


def process(start: float, power: float = 1.0) -> Process:
    """dH_1 = (start − (1 + H_2) H_1^power) dt + √(2 H_1) dB: 0 is reached where start < 1."""

    def drift(H):
        out = 1.0 - H
        out[:, 0] = start - (1.0 + H[:, 1]) * H[:, 0] ** power
        return out

    def diffusion(H):
        return 2.0 * H[:, :, None] * np.eye(2)

    return process_of(drift, diffusion, lambda H: np.full(H.shape, 2.0), (1.0, 1.0))


@pytest.mark.parametrize(
    "start, kind", [(1.5, "entrance"), (1.0, "entrance"), (0.5, "regular"), (-0.5, "exit")]
)
def test_the_edge_at_zero(start, kind):
    assert classify(process(start), 0)[0].kind == kind
    assert classify(process(start), 1)[0].kind == "entrance"


@pytest.mark.parametrize("power, kind", [(1.0, "natural"), (2.0, "entrance")])
def test_the_edge_at_infinity(power, kind):
    assert classify(process(1.0, power), 0)[1].kind == kind


def test_a_drift_outwards_does_not_confine():
    growing = process(1.0)

    def outwards(H):
        c = growing.coefficients(H)
        return c._replace(drift=-c.drift)

    wrong = replace(growing, coefficients=outwards)
    assert classify(wrong, 0)[1].kind == "not confining"
