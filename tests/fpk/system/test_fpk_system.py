"""The system of Eq. (1): matrices, Hamiltonian (5), (21), effects, modulated noise, refusals."""

import pickle
import re

import numpy as np
import pytest

from fpk import Contact, DampingTerm, System
from fpk.numeric.errors import InvalidInput, one_line_repr
from fpk.numeric.quadrature import panel_rule
from fpk.system.contact_law import LAWS
from fpk.system.modulation import Modulation
from fpk.system.system import effects_of


def system(
    mass=(1.0, 2.0), stiffness=(3.0, 4.0), damping=(0.1, 0.2), noise_intensity=(0.3, 0.4), **more
):
    return System(mass, stiffness, damping, noise_intensity, **more)


def test_matrices_are_those_of_eq_13_and_stay_as_given():
    chain = System([1.0] * 3, [2.0, 3.0, 5.0], [0.1, 0.2, 0.3], [0.1] * 3)
    expected = [[5.0, -3.0, 0.0], [-3.0, 8.0, -5.0], [0.0, -5.0, 5.0]]
    np.testing.assert_array_equal(chain.stiffness_matrix, expected)
    np.testing.assert_array_equal(chain.damping, np.diag([0.1, 0.2, 0.3]))
    given = np.array([1.0, 2.0])
    other = system(mass=given)
    given[0] = 9.0
    assert other.mass[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        other.damping[0, 0] = 9.0


def test_noise_matrix_is_gain_intensity_gain_transposed():
    D = np.array([[0.3, 0.1, 0.0], [0.1, 0.4, 0.05], [0.0, 0.05, 0.2]])
    f = np.array([[1.0, 0.5, -1.0], [0.0, 2.0, 0.25]])
    found = system(noise_intensity=D, noise_gain=f).noise_matrix
    by_hand = [
        [sum(f[i, k] * D[k, m] * f[j, m] for k in range(3) for m in range(3)) for j in range(2)]
        for i in range(2)
    ]
    np.testing.assert_allclose(found, by_hand, rtol=1e-15)


def eq_21(q, p):
    """H of (22) for the system of (21): m = (1, 2), k = (3, 4), Hertz at +0.5 (B = 7), −0.25."""
    (q1, q2), (p1, p2) = q, p
    U = 0.0
    if q2 > 0.5:
        U = 0.4 * 7.0 * (q2 - 0.5) ** 2.5
    if q2 < -0.25:
        U = 0.4 * 9.0 * (-q2 - 0.25) ** 2.5
    springs = 0.5 * 3.0 * q1**2 + 0.5 * 4.0 * (q2 - q1) ** 2
    return p1**2 / 2.0 + p2**2 / 4.0 + springs + U


def test_hamiltonian_and_potential_are_those_of_eq_21():
    contacts = (Contact(2, "right", 7.0, 0.5), Contact(2, "left", 9.0, 0.25))
    one = system(contacts=contacts)
    rng = np.random.default_rng(20041113)
    q, p = rng.normal(size=(2, 200, 2))
    expected = np.array([eq_21(*pair) for pair in zip(q, p, strict=True)])
    np.testing.assert_allclose(one.hamiltonian(q, p), expected, rtol=1e-14)
    np.testing.assert_allclose(
        one.potential(q), [eq_21(x, np.zeros(2)) for x in q], rtol=1e-14, atol=1e-15
    )
    assert one.hamiltonian(q[0], p[0]).shape == ()
    other = system(contacts=(Contact(2, "right", 7.0, 0.55), contacts[1]))
    with pytest.raises(AssertionError):
        np.testing.assert_allclose(other.hamiltonian(q, p), expected, rtol=1e-14)


def test_a_contact_of_both_sides_is_two_stops():
    one = system(
        contacts=(Contact(2, "both", 7.0, 0.5), Contact(1, "left", 3.0, 0.1, "power", 2.0))
    )
    stops = {(s.index, s.side, s.clearance, s.stiffness, s.power) for s in one.stops}
    expected = {(1, "right", 0.5, 7.0, 1.5), (1, "left", 0.5, 7.0, 1.5), (0, "left", 0.1, 3.0, 2.0)}
    assert stops == expected
    assert one.contact_masses == (0, 1) and system().stops == ()
    assert system(contacts=list(one.contacts)).contacts == one.contacts


BAD = {
    "mass": [[1.0, 0.0], [1.0, -1.0], [1.0, np.nan], [], [[1.0, 2.0]], "heavy"],
    "stiffness": [[1.0], [1.0, 0.0], [1.0, np.inf]],
    "damping": [
        [0.1, 0.2, 0.3],
        [[0.1, 0.2]],
        [-0.1, 0.2],
        [[0.1, 1.0], [1.0, 0.1]],
        [[0.1], [0.1]],
    ],
    "noise_intensity": [
        *([0.1], [-0.1, 0.1], [[0.1, 0.05], [0.0, 0.1]], [[0.1, 0.2], [0.2, 0.1]], [np.nan, 0.1])
    ],
    "noise_gain": [[[1.0, 0.0]], [1.0, 0.0]],
    "contacts": [Contact(2, "both", 10.0, 0.5), ["left"], None],
    "damping_terms": [DampingTerm(1, 1, 0.1), ["q1"]],
    "contact[1].mass": [(Contact(3, "both", 1.0, 0.5),), (Contact(0, "both", 1.0, 0.5),)],
}


@pytest.mark.parametrize("field, value", [(f, v) for f, values in BAD.items() for v in values])
def test_a_bad_field_is_named(field, value):
    with pytest.raises(InvalidInput, match=f"^{re.escape(field)} = ") as caught:
        system(**{"contacts" if field == "contact[1].mass" else field: value})
    assert caught.value.key == field
    assert "\n" not in str(caught.value)


def test_effects_follow_from_the_system():
    plain = effects_of(system())
    assert plain.stops == 0 and plain.mirror and plain.noise_rank == 2
    assert not plain.correlated_noise and not plain.coupled_damping
    full = effects_of(
        system(
            damping=[[0.1, 0.02], [0.02, 0.2]],
            noise_intensity=[0.3],
            noise_gain=[[1.0], [1.0]],
            contacts=(Contact(2, "both", 7.0, 0.5), Contact(1, "left", 3.0, 0.1, "bilinear")),
        )
    )
    assert full.laws == ("bilinear", "hertz")
    assert full.contact_masses == (0, 1) and full.stops == 3
    assert full.noise_rank == 1 and full.correlated_noise and full.coupled_damping
    assert not full.mirror
    assert hash(full) == hash(full)
    seven = Contact(2, "right", 7.0, 0.5)
    for left, mirror in (
        ((7.0, 0.5, "hertz"), True),
        ((7.0, 0.4, "hertz"), False),
        ((6.0, 0.5, "hertz"), False),
        ((7.0, 0.5, "bilinear"), False),
    ):
        one = system(contacts=(Contact(2, "left", *left), seven))
        assert effects_of(one).mirror is mirror


def test_a_fact_is_computed_once_and_not_pickled():
    one, asked = system(), []

    def fact(of):
        asked.append(of)
        return len(asked)

    assert one.fact(fact) == one.fact(fact) == 1 and asked == [one]
    assert pickle.loads(pickle.dumps(one)).n == one.n


ROWS = [
    (name, exponent)
    for name, law in sorted(LAWS.items())
    for exponent in ([law.exponent] if law.exponent is not None else [1.0, 1.3, 3.5])
]
OVERLAPS = np.geomspace(1e-3, 10.0, 41)


def increments(function):
    """∫ f dx between neighbouring overlaps by 16 Gauss points; a law is analytic beyond touch.

    A panel is 1.26 times as wide at its end as at its start, and the nearest point where x^r is not
    smooth, 0, lies 8.7 half-widths from its middle: the error falls by 17^-32.
    """
    x, w = panel_rule(OVERLAPS, 16)
    return np.sum(w * function(x), axis=-1)


@pytest.mark.parametrize("name, exponent", ROWS)
def test_energy_is_the_integral_of_force_and_force_that_of_slope(name, exponent):
    assert {"hertz", "bilinear", "power"} <= set(LAWS)
    law, zero = LAWS[name], np.zeros(1)
    for whole, rate in ((law.energy, law.force), (law.force, law.slope)):
        found = increments(lambda x, rate=rate: rate(x, exponent))
        # Round-off of a difference of neighbours, at least 0.2 of them: some ε/0.2.
        np.testing.assert_allclose(found, np.diff(whole(OVERLAPS, exponent)), rtol=2e-14)
        assert whole(zero, exponent)[0] == 0.0
        assert np.all(np.diff(whole(np.append(zero, OVERLAPS), exponent)) > 0)
    assert np.isfinite(law.slope(zero, exponent)[0]) and np.all(law.slope(OVERLAPS, exponent) > 0)
    # The energy of another exponent is seen.
    other = np.diff(OVERLAPS ** (exponent + 1.01) / (exponent + 1.01))
    assert np.max(np.abs(increments(lambda x: law.force(x, exponent)) / other - 1.0)) > 1e-3


@pytest.mark.parametrize(
    "stop", [Contact(1, "right", 1e9, 0.1), Contact(1, "right", 1e-3, 0.1, "power", 40.0)]
)
@pytest.mark.parametrize("energy", [1e-6, 1.0, 1e3])
def test_the_overlap_at_an_energy(stop, energy):
    assert stop.energy(stop.overlap_at(energy)) == pytest.approx(energy, rel=1e-9)


BAD_CONTACT = {
    "mass": ["2", 1.5],
    "side": ["up"],
    "stiffness": [0.0, -1.0, np.inf, np.nan, "10"],
    "clearance": [-1e-9, np.nan, None],
    "law": ["glue"],
    "exponent": [None, 0.9, np.nan, np.inf, 101.0, "2"],
}


@pytest.mark.parametrize(
    "field, value", [(f, v) for f, values in BAD_CONTACT.items() for v in values]
)
def test_a_bad_field_of_a_contact_is_named(field, value):
    fields = {"mass": 2, "side": "both", "stiffness": 10.0, "clearance": 0.5, "law": "power"}
    with pytest.raises(InvalidInput, match=rf"^{field} = ") as caught:
        Contact(**{**fields, "exponent": 2.0, field: value})
    assert caught.value.key == field
    assert Contact(**fields, exponent=100.0).power == 100.0
    with pytest.raises(InvalidInput, match=r"^exponent = "):
        Contact(**{**fields, "law": "hertz", "exponent": 2.0})


@pytest.mark.parametrize("rate", [-2.0, -1e-3, 0.0, 1e-6, 1e-3, 1.0, 100.0])
@pytest.mark.parametrize("seed", range(4))
def test_the_part_of_the_noise_that_damping_leaves(rate, seed):
    """∫ e² exp(−rate (end − s)) ds by quadrature; negative damping feeds energy in."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 6))
    times = np.append(0.0, np.cumsum(rng.uniform(0.5, 6.0, count - 1)))
    modulation = Modulation(times, rng.uniform(0.2, 2.0, count) * (rng.random(count) < 0.8))
    begin = rng.uniform(0.0, 3.0)
    end = begin + rng.uniform(0.1, 20.0)
    layers = end - (end - begin) * 0.5 ** np.arange(40.0)
    inner = times[(begin < times) & (times < end)]
    s, w = panel_rule(np.unique([begin, *inner, *layers, end]), 20)
    expected = float((w * modulation(s) ** 2 * np.exp(-rate * (end - s))).sum())
    # A thousand roundings of the sum by quadrature, and those of e(t) in double.
    found = float(modulation.faded(begin, end, np.array(rate)))
    assert found == pytest.approx(expected, rel=2e-12, abs=1e-300)
    if rate == 0.0:
        s, w = panel_rule(np.unique([0.0, *times[times < end], end]), 4)
        assert modulation.energy(end) == pytest.approx(float((w * modulation(s) ** 2).sum()))


@pytest.mark.parametrize(
    ("times", "factor", "word"),
    [
        ([0, 1], [1.0], "one per time"),
        ([1, 2], [0.5, 1.0], "begin with 0"),
        ([0, 2, 2], [0.5, 0.6, 1.0], "ascend"),
        ([0, 1], [-0.5, 1.0], "negative"),
        ([], [], "list"),
        ([0, np.inf], [1.0, 1.0], "finite"),
        ("x", [1.0], "finite"),
        ([0, 1], [1.0, 1e160], "must be 0 or from"),
        ([0, 1], [1.0, 1e-170], "must be 0 or from"),
    ],
)
def test_modulations_that_make_no_sense_are_refused(times, factor, word):
    with pytest.raises(InvalidInput, match=word):
        Modulation(times, factor)


@pytest.mark.parametrize("step", [1e-3, 2.0])
def test_the_mean_square_of_a_step_keeps_its_digits_after_loud_noise(step):
    """24 decades below what came before, and with kinks inside; by two points a segment, exact."""
    modulation = Modulation([0.0, 10.0, 10.5, 11.0, 20.0], [1e6, 1e6, 1e-6, 3e-6, 2e-6])
    begins = np.linspace(10.6, 21.0, 27)
    exact = []
    for begin in begins.tolist():
        inner = [t for t in modulation.times.tolist() if begin < t < begin + step]
        s, w = panel_rule(np.array([begin, *inner, begin + step]), 2)
        exact.append(float(np.sum(w * modulation(s) ** 2)) / step)
    # A step of 1e-3 at the time 20 is known to 4e-12 of itself.
    got = modulation.mean_square(begins, step)
    np.testing.assert_allclose(got, exact, rtol=1e-11)
    np.testing.assert_allclose(modulation.mean_square(begins.reshape(9, 3), step).ravel(), got)


def test_a_long_value_is_cut_to_the_width_of_a_message():
    assert one_line_repr("x" * 58) == repr("x" * 58)
    assert one_line_repr("x" * 59) == "'" + "x" * 58 + "…"
