"""The system of Eq. (1): matrices, Hamiltonian (5), (21), the plain arrays, effects, refusals."""

import pickle
import re

import numpy as np
import pytest

from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.contact import Contact
from fpk.system.damping import DampingTerm
from fpk.system.linear import (
    decay_time,
    diffusion_matrix,
    drift_matrix,
    natural_modes,
    stationary_covariance,
)
from fpk.system.system import System, effects_of

GOOD = {
    "mass": [1.0, 2.0],
    "stiffness": [3.0, 4.0],
    "damping": [0.1, 0.2],
    "noise_intensity": [0.3, 0.4],
}


def system(**changes):
    return System(**(GOOD | changes))


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


@pytest.mark.parametrize("law, exponent", [("hertz", None), ("bilinear", None), ("power", 1.3)])
@pytest.mark.parametrize("clearance", [0.0, 0.5])
def test_contact_energy_is_continuous_at_the_clearance(law, exponent, clearance):
    one = system(contacts=(Contact(2, "both", 7.0, clearance, law, exponent),))
    e = 1e-9
    # U and U' are continuous there: beyond, U rises by 7 e^(exponent + 1) at the most.
    for sign in (1.0, -1.0):
        inside = one.contact_energy(1, sign * np.linspace(0.0, clearance, 5))
        assert np.all(inside == 0.0)
        assert 0.0 < one.contact_energy(1, sign * (clearance + e)) <= 7.0 * (1.1 * e) ** 2
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


@pytest.mark.parametrize(
    "field, value",
    [
        ("mass", [1.0, 0.0]),
        ("mass", [1.0, -1.0]),
        ("mass", [1.0, np.nan]),
        ("mass", []),
        ("mass", [[1.0, 2.0]]),
        ("mass", "heavy"),
        ("stiffness", [1.0]),
        ("stiffness", [1.0, 0.0]),
        ("stiffness", [1.0, np.inf]),
        ("damping", [0.1, 0.2, 0.3]),
        ("damping", [[0.1, 0.2]]),
        ("damping", [-0.1, 0.2]),
        ("damping", [[0.1, 1.0], [1.0, 0.1]]),
        ("damping", [[0.1], [0.1, 0.2]]),
        ("noise_intensity", [0.1]),
        ("noise_intensity", [-0.1, 0.1]),
        ("noise_intensity", [[0.1, 0.05], [0.0, 0.1]]),
        ("noise_intensity", [[0.1, 0.2], [0.2, 0.1]]),
        ("noise_intensity", [np.nan, 0.1]),
        ("noise_gain", [[1.0, 0.0]]),
        ("noise_gain", [1.0, 0.0]),
        ("contact[1].mass", (Contact(3, "both", 1.0, 0.5),)),
        ("contact[1].mass", (Contact(0, "both", 1.0, 0.5),)),
    ],
)
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


def test_natural_frequencies_of_two_masses():
    # det(K − ω² M) = 0 for m = (1, 2), k = (3, 4): 2 ω⁴ − (2·7 + 4) ω² + 12 = 0.
    squares = np.sort(np.roots([2.0, -18.0, 12.0]))
    np.testing.assert_allclose(natural_modes(system())[1], np.sqrt(squares), rtol=1e-14)


def test_covariance_solves_the_lyapunov_equation():
    one = system(
        damping=[[0.1, 0.05], [-0.02, 0.2]], noise_intensity=[0.3], noise_gain=[[1.0], [0.2]]
    )
    A, b, S = drift_matrix(one), diffusion_matrix(one), stationary_covariance(one)
    # Backward stable to some ε of A Σ, n = 4.
    np.testing.assert_allclose(A @ S + S @ A.T, -b, rtol=0, atol=1e-13 * np.abs(A @ S).max())
    np.testing.assert_array_equal(S, S.T)
    assert np.linalg.eigvalsh(S)[0] > 0
    # The drift matrix acts as Eq. (6): q' = p/m, p' = −K q − c p/m.
    q, p = np.array([0.3, -0.4]), np.array([0.5, 0.6])
    v = p / one.mass
    np.testing.assert_allclose(
        A @ np.concatenate([q, p]),
        np.concatenate([v, -one.stiffness_matrix @ q - one.damping @ v]),
        rtol=1e-15,
    )


@pytest.mark.parametrize("h", [0.5, 20.0])
def test_covariance_is_that_of_gibbs_where_damping_is_h_times_noise(h):
    D = np.array([[0.05, 0.02], [0.02, 0.08]])
    one = system(damping=h * D, noise_intensity=D)
    S = stationary_covariance(one)
    # Condition of the Lyapunov equation: |A| over the decay rate, below 1e4 here.
    tol = 1e4 * np.finfo(float).eps * np.abs(S).max()
    np.testing.assert_allclose(S[:2, :2], np.linalg.inv(one.stiffness_matrix) / h, atol=tol)
    np.testing.assert_allclose(S[2:, 2:], np.diag(one.mass) / h, atol=tol)
    np.testing.assert_allclose(S[:2, 2:], 0.0, atol=tol)
    wrong = stationary_covariance(system(damping=h * np.diag([0.05, 0.08]), noise_intensity=D))
    assert np.abs(wrong - S).max() > 1e-2 * np.abs(S).max()


def test_an_undamped_mode_is_refused():
    for damping in ([0.0, 0.0], [[0.0, 0.3], [-0.3, 0.0]]):
        undamped = system(damping=damping)
        assert decay_time(undamped) == np.inf
        with pytest.raises(NotApplicable, match="not damped"):
            stationary_covariance(undamped)
    # One damper reaches both modes of the chain through the springs.
    assert decay_time(system(damping=[0.1, 0.0])) < 1e4


def test_compliance_is_the_inverse_of_the_stiffness_matrix():
    one = System([1.0] * 4, [1.0, 1e6, 3.0, 2e-3], [0.1] * 4, [0.1] * 4)
    np.testing.assert_allclose(one.compliance @ one.stiffness_matrix, np.eye(4), atol=1e-8)


def test_a_fact_is_computed_once_and_not_pickled():
    one, asked = system(), []

    def fact(of):
        asked.append(of)
        return len(asked)

    assert one.fact(fact) == one.fact(fact) == 1 and asked == [one]
    assert pickle.loads(pickle.dumps(one)).n == one.n


STOP = Contact(mass=2, side="both", stiffness=10.0, clearance=0.5)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("contacts", STOP),
        ("contacts", ["left"]),
        ("contacts", 3),
        ("contacts", None),
        ("damping_terms", DampingTerm(1, 1, 0.1)),
        ("damping_terms", ["q1"]),
    ],
)
def test_records_that_are_none_are_refused_by_name(key, value):
    with pytest.raises(InvalidInput, match=f"{key} = .*must be a tuple of "):
        System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02], **{key: value})


def test_contacts_in_a_list_are_a_tuple_and_a_mass_is_named_as_given():
    system = System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02], contacts=[STOP])
    assert system.contacts == (STOP,)
    with pytest.raises(InvalidInput, match=r"contact\[1\]\.mass = 2: is not a mass; use 1 to 1"):
        System([1], [1], [0.08], [0.01], contacts=(STOP,))


@pytest.mark.parametrize(
    ("field", "value"),
    [("mass", "2"), ("mass", 1.5), ("stiffness", "10"), ("clearance", None), ("exponent", "2"),
     ("exponent", 1e50), ("exponent", 101.0), ("exponent", float("nan"))],
)  # fmt: skip
def test_a_field_of_a_contact_that_is_no_number_of_its_kind_is_refused(field, value):
    fields = {"mass": 2, "side": "both", "stiffness": 10.0, "clearance": 0.5}
    with pytest.raises(InvalidInput, match=f"^{field} = "):
        Contact(**{**fields, "law": "power", "exponent": 2.0, field: value})
    assert Contact(**fields, law="power", exponent=100.0).power == 100.0
