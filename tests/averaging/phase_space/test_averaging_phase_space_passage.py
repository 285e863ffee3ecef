"""First passage of one mass in phase space: exact cases, identities, errors, refusals."""

from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest
from asked import assert_agree, assert_refused, passage

from averaging.phase_space.method import PhaseSpace
from averaging.phase_space.plane.elements import assemble_backward
from averaging.phase_space.plane.mesh import box_mesh, energy_mesh
from averaging.phase_space.plane.oscillator import Oscillator, oscillator_of
from fpk import Contact, System
from fpk.answer.names import parse_limit
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.solvers.square_root import SquareRoot
from fpk.system.damping import DampingTerm
from fpk.system.modulation import Modulation

STOPS = (Contact(1, "both", 10.0, 0.5),)
LINEAR = System([1.0], [1.0], [0.1], [0.05])
HERTZ = System([1.0], [1.0], [0.1], [0.05], contacts=STOPS)
ONE_SIDED = System([2.0], [1.5], [0.3], [0.3], contacts=(Contact(1, "right", 20.0, 0.3),))
NONE = np.zeros(0)


def ask(system, limit, start="rest", times=NONE, *, tol=None):
    return passage(PhaseSpace(), system, limit, start, times, tol)


def test_free_particle_leaves_an_interval_after_the_exact_time(x=0.5):
    free = Oscillator(1.0, 0.0, 0.5, lambda q: 0.0 * q, lambda q: 0.0 * q)

    def mean(level):
        e = assemble_backward(box_mesh(free, parse_limit("q1=1", 1), 0.0, level, rest=1e-16))
        return e.moments(e.at(np.array([x]), np.zeros(1), np.ones(1)))[0]

    coarse, fine = mean(0), mean(1)
    # Exit from |q| < 1 at rest: J. Masoliver and J. M. Porra, PRL 75 (1995) 189.
    y = mp.mpf(0.5 * (x + 1.0))
    series = [mp.hyp2f1(1, -mp.mpf(1) / 3, mp.mpf(7) / 6, z) for z in (y, 1 - y)]
    # v T_q + D T_vv = −1 with D = ½ and an interval of the length 2: (L²/D)^(1/3) = 2.
    scale = 2 * (mp.mpf(4) / 3) ** (mp.mpf(1) / 6) / mp.gamma(mp.mpf(7) / 3)
    exact = float(scale * (y * (1 - y)) ** (mp.mpf(1) / 6) * sum(series))
    assert abs(fine - exact) <= abs(fine - coarse)  # which is stated
    assert abs(fine / exact - 1.0) < 1e-6


@pytest.mark.parametrize(
    ("start", "energy", "ratio"),
    [("rest", 0.0, 2.0**1.5), ("q1=0.7,p1=0.714142842854285", 0.5, 2.0)],
)
def test_light_damping_tends_to_the_averaged_energy(start, energy, ratio):
    """ε T at c = D = ε tends to the square-root process: T depends on the phase by O(1), so by O(ε)
    of itself; at rest there is no phase, and O(ε^1.5) is left, of the points of the limit where
    v = 0 and no noise moves H."""
    exact = SquareRoot(1, 1.0, 1.0).passage(1.5, energy, NONE, tol=1e-10).mean.value
    off = []
    for damping in (0.02, 0.01, 0.005):
        answer = ask(System([1.0], [1.0], [damping], [damping]), "H=1.5", start, tol=1e-5)
        assert answer.certificate.certified
        off.append(damping * answer.mean.value / exact - 1.0)
    ratios = np.array(off[:-1]) / off[1:]
    # The next power is half an order above: it alters ratios by O(√ε), 0.07 at the least damping.
    assert np.all(np.abs(ratios / ratio - 1.0) < 0.07)
    assert abs(ratios[1] - ratio) < abs(ratios[0] - ratio)


def test_without_damping_energy_grows_evenly_to_the_limit():
    """E H(T) = (D/m) E T of the undamped motion, by Dynkin's formula: from rest E T = m E/D."""
    answer = ask(System([2.0], [1.0], [0.0], [0.5], contacts=STOPS), "H=1", tol=1e-5)
    assert abs(answer.mean.value - 4.0) <= answer.mean.error < 1e-4


def test_mean_time_is_the_integral_of_the_reliability():
    times = np.linspace(0.0, 120.0, 481)
    answer = ask(ONE_SIDED, "H=1.5", "q1=-0.2,p1=0.3", times)
    assert answer.certificate.certified
    S, rate = answer.survival, answer.rate.value
    weights = np.full(times.size, 2.0)
    weights[1::2], weights[[0, -1]] = 4.0, 1.0
    integral = 0.25 / 3.0 * float(weights @ S) + S[-1] / rate
    # Simpson's error is that of S at the steps: 1e-7; those of S add up to 120 times theirs.
    allowed = 120.0 * float(answer.survival_error.max()) + answer.mean.error + 1e-4
    assert abs(integral - answer.mean.value) < allowed
    ratio = float(np.log(S[-41] / S[-1]) / 10.0)
    assert ratio == pytest.approx(rate, rel=1e-4)


STEEP_STOP = Contact(1, "right", 8.455e6, 0.0853, "power", 3.0)
STEEP = System([0.856], [6.83], [0.903], [0.498], contacts=(STEEP_STOP,))
LAYER_STOP = Contact(1, "right", 9633.055295041624, 0.0, "hertz")
LAYER = System([0.33811676], [1.47493708], [1.23676378], [0.05087863], contacts=(LAYER_STOP,))
"""The overlap in which the stop turns a kick of noise back is a hundredth of the amplitude."""


@pytest.mark.parametrize(
    ("system", "limit", "start", "tols"),
    [
        (HERTZ, "H=1", "H=0.4", (1e-3, 1e-5)),
        (LAYER, "H=0.046", "rest", (1e-5, 1e-7)),
        # At or beyond a steep stop: passed on the other side.
        (STEEP, "q1=0.0853", "rest", (3e-2, 1e-5)),
        pytest.param(STEEP, "q1=0.2", "rest", (3e-2, 1e-3), marks=pytest.mark.slow),
        pytest.param(ONE_SIDED, "H=2", "q1=-0.5,p1=0.4", (1e-3, 1e-6), marks=pytest.mark.slow),
    ],
)
def test_true_errors_are_below_the_stated_ones(system, limit, start, tols, capfd):
    coarse, fine = (ask(system, limit, start, [0.0, 1.0, 5.0, 20.0], tol=tol) for tol in tols)
    assert_agree(coarse, fine)
    assert fine.certificate.certified, fine.certificate.failures
    assert abs(coarse.mean.value - fine.mean.value) > 0.0 and coarse.mean.error > fine.mean.error
    assert np.all(np.abs(coarse.survival - fine.survival) <= coarse.survival_error)
    assert capfd.readouterr() == ("", "")


def test_energy_start_is_the_mean_over_the_phase():
    """Without stops dt is uniform in the angle: trapezoidal means of starts at states."""
    answer = ask(LINEAR, "H=1", "H=0.5", [0.0, 4.0])
    angles = 2.0 * np.pi * np.arange(4) / 8
    one = [
        ask(LINEAR, "H=1", f"q1={np.cos(a)},p1={np.sin(a)}", tol=1e-5).mean.value for a in angles
    ]
    assert answer.mean.value == pytest.approx(np.mean(one), rel=1e-3)
    assert np.ptp(one) > 0.01
    assert answer.survival[0] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    ("limit", "share"), [("q1=1", 0.5), ("v1=1", 0.5), ("q1>1", 0.75), ("v1<-1", 0.75)]
)
def test_part_of_an_energy_start_may_be_beyond_a_state(limit, share):
    answer = ask(LINEAR, limit, "H=1", [0.0], tol=3e-2)
    assert answer.survival[0] == pytest.approx(share, abs=1e-10)  # |sin| < 1/√2 half of the time


def test_velocity_of_a_weak_spring_is_the_ornstein_uhlenbeck_process():
    """Of |v| = 1 in units of its rms, T₀ = √(π/2) ∫ exp(v²/2) erf(v/√2) dv, and the failure rate is
    2 of the decay, as He₂ = v² − 1 vanishes there; the spring alters both by O(k)."""
    slope = lambda v: mp.exp(v * v / 2) * mp.erf(v / mp.sqrt(2))  # noqa: E731
    exact = float(mp.sqrt(mp.pi / 2) * mp.quad(slope, [0, 1]))
    answers = [ask(System([1.0], [k], [1.0], [1.0]), "v1=1", tol=1e-4) for k in (0.04, 0.02, 0.01)]
    off = np.array([[a.mean.value / exact - 1.0, a.rate.value / 2.0 - 1.0] for a in answers])
    assert off[:-1] / off[1:] == pytest.approx(2.0, rel=0.01)
    assert np.all(np.abs(off[-1]) < 2e-4)


def test_rare_sides_are_passed_independently_and_as_often_as_levels_are_crossed():
    """At b = 5 rms with half of the critical damping crossings come alone: the failure rate of one
    side tends to that of upcrossings, exp(−b²/2)/(2π) (Rice), by 1/b², and of both to twice it."""
    both, right = (ask(System(*np.ones((4, 1))), f"q1{limit}", tol=1e-2) for limit in ("=5", ">5"))
    assert both.rate.value / right.rate.value == pytest.approx(2.0, abs=1e-3)
    assert 0.96 < right.rate.value * 2.0 * np.pi / np.exp(-12.5) < 1.0


@pytest.mark.parametrize("limits", [("q1>0.6", "q1<-0.6"), ("v1>1", "v1<-1"), ("v1<-1", "v1>1")])
def test_one_side_is_passed_as_its_mirror(limits):
    sides = [replace(LINEAR, contacts=(Contact(1, x, 5.0, 0.4),)) for x in ("right", "left")]
    one, other = (ask(*given, tol=1e-2) for given in zip(sides, limits, strict=True))
    assert one.mean.value == pytest.approx(other.mean.value, rel=1e-10)


def test_rare_failure_keeps_its_digits():
    """K is nearly singular to 1e-10: the flow out gives back what round-off takes."""
    answer = ask(HERTZ, "H=12", times=[100.0, 200.0, 300.0], tol=1e-2)
    assert answer.certificate.certified
    assert answer.failure is not None and answer.failure_error is not None
    assert np.all(answer.failure_error < 0.1 * answer.failure)
    # Once energies below have filled, failures come at the constant rate.
    growth = np.diff(answer.failure) / 100.0
    assert growth == pytest.approx([answer.rate.value] * 2, rel=1e-2)
    assert answer.mean.value == pytest.approx(2.0607947e10, rel=answer.mean.error / 2e10)
    assert answer.mean.value * answer.rate.value == pytest.approx(1.0, rel=1e-8)


def test_mass_is_conserved_and_a_loss_is_seen():
    e = assemble_backward(energy_mesh(oscillator_of(HERTZ), 1.5, 0))
    start = e.at(np.zeros(1), np.array([1.7]), np.ones(1))  # H = 1.445
    assert e.mass_defect(start) < 1e-13  # some hundred roundings
    # Half of what has left by 1/σ, in which noise moves H by √(2D/σ) v = 0.28, five times as far
    # as the limit is away: some tens of per cent have.
    assert 0.05 < replace(e, exit=0.5 * e.exit).mass_defect(start) < 0.5


def test_units_and_gain():
    """q' = 2 q and t' = ω t, ω = 2: D' = (2/m)² f² D/ω³, and times are twice as long."""
    scaled = System([3.0], [12.0], [0.6], [0.5], noise_gain=[[1.2]])
    unit = System([1.0], [1.0], [0.1], [4.0 * 0.72 / 9.0 / 8.0])
    a, b = ask(scaled, "q1=0.5", tol=1e-2), ask(unit, "q1=1", tol=1e-2)
    assert 2.0 * a.mean.value == pytest.approx(b.mean.value, rel=1e-9)
    assert 4.0 * a.variance.value == pytest.approx(b.variance.value, rel=1e-9)


@pytest.mark.parametrize("limit", ["H=0.5", "q1=0.6"])
def test_damping_by_a_term_is_as_the_same_damping(limit):
    """A term of degree 0 is constant, but its weight is fitted."""
    term = replace(HERTZ, damping=[[0.04]], damping_terms=(DampingTerm(1, 1, 0.06),))
    one, other = (ask(system, limit, times=[2.0, 10.0], tol=1e-4) for system in (HERTZ, term))
    assert_agree(one, other)
    assert other.certificate.certified


@pytest.mark.parametrize(
    ("limit", "tol", "mean", "survival"),
    [
        ("q1>1.5", 1e-2, (5.43100, 0.01086), ([0.87970, 0.48708], [0.00127, 0.00200])),
        ("v1>2.2", 3e-2, (6.32340, 0.01398), ([0.95306, 0.59314], [0.00088, 0.00193])),
        ("q1=1.5", 1e-3, (3.64875, 0.00383), ([0.76113, 0.19765], [0.00083, 0.00088])),
        ("H=3", 1e-3, (4.55704, 0.00529), ([0.91259, 0.31705], [0.00064, 0.00098])),
    ],
)
def test_van_der_pol_passes_as_in_a_simulation(limit, tol, mean, survival):
    """262,144 paths by ``montecarlo`` with the seed 3, ± a standard error; of one side 65,536."""
    term = DampingTerm(1, 1, 1.0, q=((1, 2),))
    system = System([1.0], [1.0], [-1.0], [0.3], damping_terms=(term,))
    answer = ask(system, limit, times=[2.0, 5.0], tol=tol)
    assert answer.certificate.certified, answer.certificate.failures
    assert abs(answer.mean.value - mean[0]) <= 4.0 * mean[1] + answer.mean.error
    known, error = np.array(survival)
    assert np.all(np.abs(answer.survival - known) <= 4.0 * error + answer.survival_error)


WAITING = Modulation(np.array([0.0, 1.0]), np.array([0.0, 1.0]))


@pytest.mark.parametrize(
    ("system", "limit", "start", "error", "words"),
    [
        (System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.1, 0.1]), "H=1", "rest", NotApplicable,
         "one mass"),
        (replace(LINEAR, modulation=WAITING), "H=1", "rest", NotApplicable, "modulated"),
        (System([1.0], [1.0], [0.1], [0.0]), "H=1", "rest", NotApplicable, "no noise"),
        (HERTZ, "H1=1", "rest", NotApplicable, "mode"),
        (HERTZ, "H=1", "H1=0.5", NotApplicable, "mode"),
        (HERTZ, "H=1", "noise=0.5", NotApplicable, "stationary"),
        (HERTZ, "H=1", "H=1", InvalidInput, "beyond the limit"),
        (HERTZ, "q1=1", "q1=-1", InvalidInput, "beyond the limit"),
        (HERTZ, "q1>-0.1", "rest", InvalidInput, "beyond the limit"),
        (HERTZ, "q1<2", "H=0.5", InvalidInput, "beyond the limit"),
        (HERTZ, "v1>1", "p1=1", InvalidInput, "beyond the limit"),
        (System([1.0], [0.04], [1.0], [1.0]), "v1>1", "rest", NotCertified, "use montecarlo"),
        (HERTZ, "H=40", "rest", NotCertified, "hardly ever"),
        (HERTZ, "q1=1", "p1=9", NotCertified, "energy of the start is hardly ever"),
    ],
)  # fmt: skip
def test_refusals_are_one_line(system, limit, start, error, words):
    assert_refused(error, words, ask, system, limit, start)
