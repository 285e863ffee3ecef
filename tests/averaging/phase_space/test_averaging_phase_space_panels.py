"""Functions of the contact displacement: derivatives, nesting, and what is left of their number."""

from itertools import pairwise, product

import numpy as np
import pytest

import fpk
from averaging.phase_space.equation import degrees as degrees_module
from averaging.phase_space.equation.basis import basis
from averaging.phase_space.equation.degrees import Degrees, fitting_degrees, space_to
from averaging.phase_space.equation.elimination import expand, inverse_by_quarters
from averaging.phase_space.equation.frame import (
    contact_frame,
    gaussian_start,
    gibbs_reference,
    make_reference,
)
from averaging.phase_space.marginals import marginal
from averaging.phase_space.refinement import fit_reference, reference_by_moments
from fpk.answer.names import parse_observable
from fpk.numeric.quadrature import gauss_grid, integral

DEGREES = Degrees(total=16, others=6, outer=18)


def frame_of(*contacts, clearance=0.5):
    both = fpk.Contact(mass=2, side="both", stiffness=10.0, clearance=clearance)
    return contact_frame(
        fpk.System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02], contacts=contacts or (both,))
    )


def right(stiffness=10.0, clearance=0.5):
    return fpk.Contact(mass=2, side="right", stiffness=stiffness, clearance=clearance)


@pytest.mark.parametrize("odd", [False, True])
@pytest.mark.parametrize(
    "frame",
    [
        frame_of(),
        frame_of(clearance=1.5),
        frame_of(right()),
        frame_of(right(), right(clearance=0.8)),
        contact_frame(fpk.System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02])),
    ],
    ids=["both", "distant", "right", "two on a side", "none"],
)
def test_derivatives_map_one_set_of_functions_onto_the_other(frame, odd):
    b = basis(frame, gibbs_reference(frame), DEGREES, odd=odd)
    values, slopes = b.functions(b.points)
    w = b.weights[:, None]
    for functions in (b.continuous, b.broken):
        unit = (values @ functions).T @ (w * (values @ functions))
        assert unit == pytest.approx(np.eye(functions.shape[1]), abs=1e-11)
    D = (values @ b.broken).T @ (w * (slopes @ b.continuous))
    # The function 1 has no derivative; where all functions are odd it is not among them.
    kernel = int(b.mirrored is False or not odd)
    assert b.broken.shape[1] == b.continuous.shape[1] - kernel
    sizes = np.linalg.svd(D, compute_uv=False)[: b.broken.shape[1]]
    # The slowest function between the ends of the support has one half-wave: none is slower by far.
    length = b.nodes[-1] - b.nodes[0]
    assert sizes[-1] > 1.0 / length
    if kernel:
        assert b.of_one @ b.of_one == pytest.approx(1.0, abs=1e-12)
        assert D @ b.of_one == pytest.approx(0.0, abs=1e-9)


def test_sets_with_fewer_polynomials_are_the_front_of_larger_ones():
    b = basis(frame_of(), gibbs_reference(frame_of()), DEGREES)
    for columns, counts in zip((b.continuous, b.broken), b.counts, strict=True):
        assert counts == tuple(sorted(counts)) and counts[-1] == columns.shape[1]
    degree = np.concatenate([np.arange(p.degree) for p in b.panels])
    outer = np.concatenate([np.full(p.degree, p.last) for p in b.panels])
    for count in range(4, DEGREES.outer + 1):
        front = b.continuous[:, : b.counts[0][count]]
        assert front[outer & (degree >= count)] == pytest.approx(0.0, abs=1e-12)


def test_more_polynomials_between_stops_change_nothing(monkeypatch):
    """With continuous functions in levels of all degrees the change was some 1e-3."""
    frame, about = frame_of(clearance=1.5), gibbs_reference(frame_of(clearance=1.5))
    for _ in range(2):
        about = reference_by_moments(expand(frame, about, DEGREES))
    densities = []
    for more in (0, 2, 4, 8):
        monkeypatch.setattr(
            Degrees,
            "between",
            lambda self, width, beyond, more=more: 2 * (self.outer // 2) + 1 + more,
        )
        e = expand(frame, about, Degrees(40, 6, 20))
        densities.append(marginal(e, parse_observable("q2", 2)))
    mesh, grids = gauss_grid(densities[0][0])
    last = densities[-1][1](*mesh)
    distances = [integral(np.abs(pdf(*mesh) - last), grids) for _, pdf in densities[:-1]]
    assert min(distances) > 0.0
    # Polynomials of degree 20 leave 1e-6 of a function that varies over a standard deviation.
    assert max(distances) < 1e-5


@pytest.mark.parametrize(("d", "most"), [(3, 4), (5, 2)])
def test_the_others_count_by_the_larger_degree_in_an_amplitude_or_its_conjugate(d, most):
    total = 2 * most + 2
    space = space_to(total, most, d)
    degrees = list(product(range(most + 1), repeat=d - 1))
    counted = [sum(map(max, zip(k[::2], k[1::2], strict=True))) for k in degrees]
    # At levels as high as all sums of degrees in the others, each product stands once.
    own = space.counted[space.span(total)]
    assert own.size == sum(c <= most for c in counted)
    assert space.others[space.span(total)].max() == 2 * most
    up = [A.toarray() for A in space.up]
    inside = (space.level < total) & (space.counted < most)
    for i, j in product(range(d), repeat=2):
        # a_i a_j⁺ − a_j⁺ a_i = δ_ij wherever raising does not lead out of the set.
        commutator = (up[i].T @ up[j] - up[j] @ up[i].T)[inside]
        assert commutator == pytest.approx(np.eye(space.level.size)[inside] * (i == j), abs=1e-12)
    for mode in range(1, d, 2):
        # What turns an oscillator leaves what a product counts.
        v, x = up[mode], up[mode + 1]
        turned = v @ x.T - x @ v.T
        assert np.all(turned[space.counted[:, None] != space.counted] == 0.0)


def test_the_degree_in_the_others_rises_where_something_is_left():
    rises = []
    for stiffness, clearance in ((10.0, 0.5), (100.0, 0.1)):
        stop = fpk.Contact(mass=2, side="both", stiffness=stiffness, clearance=clearance)
        system = fpk.System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02], contacts=(stop,))
        frame = contact_frame(system)
        about = reference_by_moments(expand(frame, gibbs_reference(frame), Degrees(14, 5, 16)))
        rises.append(expand(frame, about, Degrees(20, 8, 20)).rise)
    assert rises == [2, 0]


def test_a_block_that_is_singular_in_front_is_inverted_between_its_cuts():
    turn = np.array([[0.0, 1.0], [-1.0, -0.1]])
    A = np.kron(np.eye(300), turn)
    A[:300, 300:] += 0.1 * np.eye(300)
    assert inverse_by_quarters(A, range(0, 600, 2)) @ A == pytest.approx(np.eye(600), abs=1e-11)


def test_high_levels_have_fewer_polynomials_but_not_too_few():
    counts = [[DEGREES.beyond(n, m) for m in range(7)] for n in range(17)]
    assert counts[0][0] == counts[1][0] == DEGREES.outer
    assert all(a >= b for row in counts for a, b in pairwise(row))
    least = int(degrees_module.LEAST_MIXED * DEGREES.outer)
    assert min(map(min, counts)) >= least > 1


def test_a_reference_that_is_no_distribution_is_refused():
    frame = frame_of()
    good = gibbs_reference(frame)
    with pytest.raises(np.linalg.LinAlgError):
        make_reference(frame, good.slope, good.offset, -good.covariance)


@pytest.mark.parametrize(("clearance", "narrowed"), [(0.1, True), (0.5, False)])
def test_a_near_stop_makes_the_reference_narrower(clearance, narrowed):
    frame = frame_of(clearance=clearance)
    found = fit_reference(frame, gaussian_start(frame))
    plain = reference_by_moments(expand(frame, gaussian_start(frame), fitting_degrees(frame)))
    ratio = found.covariance[0, 0] / plain.covariance[0, 0]
    assert ratio < 0.9 if narrowed else ratio == pytest.approx(1.0, rel=1e-2)
    tops = [expand(frame, r, fitting_degrees(frame)).top for r in (found, plain)]
    assert tops[0] < 0.9 * tops[1] if narrowed else tops[0] == pytest.approx(tops[1], rel=0.05)
