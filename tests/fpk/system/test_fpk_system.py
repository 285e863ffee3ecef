"""The system of Eq. (1): matrices, Hamiltonian (5), (21), the plain arrays, effects, refusals."""

import pickle
import re

import numpy as np
import pytest

from fpk import Contact, DampingTerm, System
from fpk.numeric.errors import InvalidInput
from fpk.system.system import effects_of


def system(
    mass=(1.0, 2.0), stiffness=(3.0, 4.0), damping=(0.1, 0.2), noise_intensity=(0.3, 0.4), **more
):
    return System(mass, stiffness, damping, noise_intensity, **more)


def test_diagonals_become_matrices_and_stay_read_only():
    one = system()
    np.testing.assert_array_equal(one.damping, [[0.1, 0.0], [0.0, 0.2]])
    np.testing.assert_array_equal(one.noise_intensity, [[0.3, 0.0], [0.0, 0.4]])
    np.testing.assert_array_equal(one.noise_gain, np.eye(2))
    with pytest.raises(ValueError, match="read-only"):
        one.damping[0, 0] = 9.0
    given = np.array([1.0, 2.0])
    other = system(mass=given)
    given[0] = 9.0
    assert other.mass[0] == 1.0


def test_stiffness_matrix_is_that_of_eq_13():
    chain = System([1.0] * 3, [2.0, 3.0, 5.0], [0.1] * 3, [0.1] * 3)
    expected = [[5.0, -3.0, 0.0], [-3.0, 8.0, -5.0], [0.0, -5.0, 5.0]]
    np.testing.assert_array_equal(chain.stiffness_matrix, expected)
    np.testing.assert_array_equal(System([1.0], [2.0], [0.1], [0.1]).stiffness_matrix, [[2.0]])


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


@pytest.mark.parametrize("law, exponent", [("hertz", None), ("bilinear", None)])
@pytest.mark.parametrize("clearance", [0.0, 0.5])
def test_contact_energy_is_continuous_at_the_clearance(law, exponent, clearance):
    one = system(contacts=(Contact(2, "both", 7.0, clearance, law, exponent),))
    # U and U' are continuous there: beyond, U rises by 7 e^(exponent + 1) at the most.
    for sign in (1.0, -1.0):
        assert np.all(one.contact_energy(1, sign * np.linspace(0.0, clearance, 5)) == 0.0)
        assert 0.0 < one.contact_energy(1, sign * (clearance + 1e-9)) <= 7.0 * 1.1e-9**2
    assert one.contact_energy(0, clearance + 1.0) == 0.0


def test_a_contact_of_both_sides_is_two_stops():
    one = system(
        contacts=(Contact(2, "both", 7.0, 0.5), Contact(1, "left", 3.0, 0.1, "power", 2.0))
    )
    stops = {(s.index, s.side, s.clearance, s.stiffness, s.power) for s in one.stops}
    expected = {(1, "right", 0.5, 7.0, 1.5), (1, "left", 0.5, 7.0, 1.5), (0, "left", 0.1, 3.0, 2.0)}
    assert stops == expected
    assert one.contact_masses == (0, 1)
    assert system().stops == ()


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


@pytest.mark.parametrize(
    "left, right, mirror",
    [
        ((7.0, 0.5, "hertz"), (7.0, 0.5, "hertz"), True),
        ((7.0, 0.5, "hertz"), (7.0, 0.4, "hertz"), False),
        ((7.0, 0.5, "hertz"), (6.0, 0.5, "hertz"), False),
        ((7.0, 0.5, "hertz"), (7.0, 0.5, "bilinear"), False),
    ],
)
def test_mirror_says_whether_the_potential_is_even(left, right, mirror):
    one = system(contacts=(Contact(2, "left", *left), Contact(2, "right", *right)))
    assert effects_of(one).mirror is mirror
    q = np.random.default_rng(7).normal(size=(50, 2))
    assert np.allclose(one.potential(q), one.potential(-q), rtol=1e-13, atol=0.0) is mirror


def test_a_fact_is_computed_once_and_not_pickled():
    one, asked = system(), []

    def fact(of):
        asked.append(of)
        return len(asked)

    assert one.fact(fact) == one.fact(fact) == 1 and asked == [one]
    assert pickle.loads(pickle.dumps(one)).n == one.n


STOP = Contact(2, "both", 10.0, 0.5)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("contacts", STOP),
        ("contacts", ["left"]),
        ("contacts", None),
        ("damping_terms", DampingTerm(1, 1, 0.1)),
        ("damping_terms", ["q1"]),
    ],
)
def test_records_of_the_wrong_kind_are_refused_by_name(key, value):
    with pytest.raises(InvalidInput, match=f"{key} = .*must be a tuple of "):
        system(**{key: value})


def test_contacts_in_a_list_are_a_tuple_and_a_mass_is_named_as_given():
    assert system(contacts=[STOP]).contacts == (STOP,)
    with pytest.raises(InvalidInput, match=r"contact\[1\]\.mass = 2: is not a mass; use 1 to 1"):
        System([1], [1], [0.08], [0.01], contacts=(STOP,))
