"""NaN is not lost where the largest of several residuals is taken."""

from itertools import count

import numpy as np
import pytest
from systems import both, fig6
from test_fpk_plane import square_root_process
from test_fpk_plane_time import density

from averaging.energy_process import energy_process
from fpk.solvers.line.elements import _residuals
from fpk.solvers.line.time import resolvent
from fpk.solvers.line.time.elements import degree_for, element_pair
from fpk.solvers.line.time.transition import Source
from fpk.solvers.plane.solution import root_spaced_nodes
from fpk.solvers.plane.time import passage, transient
from fpk.solvers.plane.time.operator import PlaneOperator, PlaneStart

TIMES = np.array([1.0, 100.0])
"""Apart by more than one contour and one Krylov space serve."""


def nan_at(k):
    """A residual that is 0 but at its call number ``k``."""
    calls = count()
    return lambda *_: np.nan if next(calls) == k else 0.0


@pytest.mark.parametrize("k", [0, 1])
def test_of_contours(monkeypatch, k):
    process = energy_process(fig6(both(10.0)))
    e, _ = element_pair(process, np.linspace(0.0, 4.0 * process.energy_scale, 9), degree_for(1e-4))
    own, residual = resolvent.chain_resolvent, nan_at(k)
    monkeypatch.setattr(
        resolvent, "chain_resolvent", lambda *asked, **how: (own(*asked, **how)[0], residual())
    )
    assert np.isnan(resolvent.inverse_laplace(e, Source().load(e), TIMES).residual)


@pytest.mark.parametrize("k", [0, 2, 4])
def test_of_krylov_spaces(monkeypatch, k):
    nodes = root_spaced_nodes((5.0, 5.0), 3)
    op = PlaneOperator(square_root_process((0.1, 0.2), (0.1, 0.2)), nodes, 5)
    A, M, _ = op.matrices
    dual = PlaneStart(np.zeros(2)).dual(op)
    made = []
    residual = nan_at(k)
    monkeypatch.setattr(
        transient, "relative_residual", lambda *_: made.append(residual()) or made[-1]
    )
    answer = transient.krylov_exponential(A, M, dual, TIMES, tol=1e-6)
    assert len(made) > 4 and np.isnan(answer.residual)


def test_of_a_reliability(monkeypatch):
    def without(*asked, **how):
        return transient.krylov_exponential(*asked, **how)._replace(residual=np.nan)

    monkeypatch.setattr(passage, "krylov_exponential", without)
    answer = passage.plane_first_passage(
        density(square_root_process((0.1, 0.1), (0.05, 0.05))), PlaneStart(np.zeros(2)),
        passage.PlaneLimit(total=1.0), TIMES, tol=1e-2,
    )  # fmt: skip
    assert np.isnan(answer.certificate.residual) and not answer.certificate.certified


@pytest.mark.parametrize(("i", "j"), [(0, 0), (1, 3)])
def test_of_an_element(i, j):
    A = np.ones((2, 3, 4))
    A[1, i, j] = np.nan
    assert np.isnan(_residuals(A, np.ones((2, 4)))[0]).tolist() == [False, True]
