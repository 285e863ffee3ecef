"""Nested dissection of elements of two energies against one factorisation, and its cost."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from test_fpk_plane import manufactured

from fpk.plane import condensation
from fpk.plane.condensation import skeleton
from fpk.plane.on_mesh import solve_plane_on_mesh


@pytest.mark.parametrize("counts", [(1, 1), (1, 3), (2, 1), (3, 5), (6, 4)])
@pytest.mark.parametrize("degree", [4, 7])
def test_merging_gives_what_one_factorisation_gives(
    counts: tuple[int, int], degree: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    process, _ = manufactured(0.4, 0.2)
    nodes = np.linspace(0.0, 2.0, counts[0] + 1), np.linspace(0.0, 1.5, counts[1] + 1)
    merged = solve_plane_on_mesh(process, nodes, degree)
    skeleton.cache_clear()
    monkeypatch.setattr(condensation, "MOST_MERGED", 0)
    whole = solve_plane_on_mesh(process, nodes, degree)
    skeleton.cache_clear()
    x, y = np.linspace(0.0, 2.0, 41)[:, None], np.linspace(0.0, 1.5, 37)
    p = whole.density(x, y)
    assert_allclose(merged.density(x, y), p, rtol=0.0, atol=1e-11 * p.max())
    assert merged.certificate.residual < 1e-14


@pytest.mark.parametrize(("first", "second"), [((8, 8), (16, 16)), ((6, 12), (12, 24))])
def test_the_work_of_merging_grows_as_unknowns_to_the_power_of_one_and_a_half(
    first: tuple[int, int], second: tuple[int, int]
) -> None:
    # Multiplications of the eliminations: n² k + n k² + n³/3 for n unknowns that k others stay of.
    work = []
    for counts in (first, second):
        plan = skeleton(counts, 6).plan
        assert plan is not None
        done = [(m.eliminated, m.size - m.eliminated) for m in plan.merges]
        work.append(sum(n**2 * k + n * k**2 + n**3 / 3.0 for n, k in done))
        # Nothing is lost on the way: all but what the last one holds is eliminated once.
        assert sum(n for n, _ in done) + plan.last.size == skeleton(counts, 6).size
    # Rectangles at the edges have fewer neighbours, fewer of all on the larger mesh.
    assert np.log(work[1] / work[0]) / np.log(4.0) <= 1.5 + 0.15
