"""The chain of masses, springs, dampers, noises and contacts of Eq. (1), and which act in it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from fpk.numeric.arrays import ROUND_OFF, Array
from fpk.numeric.errors import InvalidInput, require
from fpk.system.contact import Contact
from fpk.system.damping import DampingTerm
from fpk.system.modulation import Modulation

Fact = TypeVar("Fact")


@dataclass(frozen=True, eq=False)
class System:
    """Randomly excited and dissipated Hamiltonian system, Eqs. (1), (4), (6).

    ``dq = M⁻¹p dt``, ``dp = (−K q − g(q) − c M⁻¹ p) dt + f √(2D) dB`` (Ito; corrected from (6),
    which omits the factor √(2D) although ``E[W_k W_l'] = 2 D_kl δ``).

    ``mass`` (n,) > 0. ``stiffness`` (n,) > 0: k_i joins mass i to mass i−1, k_1 to the wall.
    ``damping`` c: (n,) for a diagonal or (n, n); its symmetric part must not be negative, unless
    ``damping_terms`` make c depend on the state: then it may feed energy in where they take it out.
    ``noise_intensity`` D: (l,) for a diagonal or (l, l), symmetric, positive semidefinite.
    ``noise_gain`` f: (n, l), the identity when left out. ``contacts``: any number on any masses.
    ``damping_terms``: monomials of the state added to entries of c; a term without powers is added
    to the constant matrix, a term with the coefficient 0 is dropped.
    ``modulation`` e(t) multiplies the noise intensity by e² in motions that begin at time 0;
    stationary states and the methods that solve for them ignore it.
    ``noise_matrix`` is f D fᵀ, ``stiffness_matrix`` K, (n, n) each. All arrays are read-only, in
    float64 and full matrix form.

    Two masses, the second between stops (Fig. 6(a))::

        stop = fpk.Contact(mass=2, side="both", stiffness=10.0, clearance=0.5)
        system = fpk.System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02], contacts=(stop,))
        system.n, system.stops
        system.potential(np.array([0.2, 0.6])), system.contact_energy(1, 0.6)
        system.hamiltonian(np.array([0.2, 0.6]), np.array([0.0, 0.1]))

    Raises ``InvalidInput`` with the name of the field that cannot be used.
    """

    mass: Array
    stiffness: Array
    damping: Array
    noise_intensity: Array
    noise_gain: Array | None = None
    contacts: tuple[Contact, ...] = ()
    damping_terms: tuple[DampingTerm, ...] = ()
    modulation: Modulation | None = None
    noise_matrix: Array = field(init=False)
    stiffness_matrix: Array = field(init=False)
    _facts: dict[Callable[..., Any], Any] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        """Check the fields, or raise ``InvalidInput``; store matrices, f D fᵀ and K."""
        for key, kind in (("contacts", Contact), ("damping_terms", DampingTerm)):
            given = getattr(self, key)
            fits = isinstance(given, (tuple, list)) and all(isinstance(x, kind) for x in given)
            require(fits, key, given, f"must be a tuple of {kind.__name__}, as (first, second)")
        mass, stiffness = _finite("mass", self.mass), _finite("stiffness", self.stiffness)
        for key, array in (("mass", mass), ("stiffness", stiffness)):
            given, fits = getattr(self, key), array.ndim == 1 and array.size > 0
            require(fits, key, given, "must be a list of one number per mass")
            require((array > 0).all(), key, given, "must hold positive numbers only")
        n = mass.size
        words = f"must have {n} {'entry' if n == 1 else 'entries'}, one per mass"
        require(stiffness.size == n, "stiffness", self.stiffness, words)
        damping, words = _matrix("damping", self.damping), f"must have {n} entries or be {n} x {n}"
        require(damping.shape[0] == n, "damping", self.damping, words)
        masses = {f"contact[{k}].mass": c.mass for k, c in enumerate(self.contacts, start=1)}
        terms = []  # the terms that depend on the state
        for k, term in enumerate(self.damping_terms, start=1):
            masses |= {f"damping_term[{k}].{place}": at for place, at in term.masses.items()}
        for key, at in masses.items():
            require(1 <= at <= n, key, at, f"is not a mass; use 1 to {n}")
        for term in self.damping_terms:
            if term.degree == 0:
                damping[term.row, term.column] += term.coefficient
            elif term.coefficient != 0.0:
                terms.append(term)
        if not terms:
            _refuse_negative("damping", damping, "does not dissipate: its symmetric part has")
        key, given = "noise_intensity", self.noise_intensity
        intensity = _matrix(key, given)
        noises, skew = intensity.shape[0], np.abs(intensity - intensity.T)
        require((skew <= ROUND_OFF * np.abs(intensity)).all(), key, given, "must be symmetric")
        _refuse_negative(key, intensity, "is not positive semidefinite: it has")
        if self.noise_gain is None:
            require(noises == n, key, given, f"{words} (or give noise_gain, {n} x {noises})")
            gain = np.eye(n)
        else:
            gain = _finite("noise_gain", self.noise_gain)
            fits = gain.shape == (n, noises)
            require(fits, "noise_gain", self.noise_gain, f"must be {n} x {noises}")
        extension = np.eye(n) - np.eye(n, k=-1)  # of each spring, from the displacements
        arrays = {
            "mass": mass,
            "stiffness": stiffness,
            "damping": damping,
            "noise_intensity": intensity,
            "noise_gain": gain,
            "noise_matrix": gain @ intensity @ gain.T,
            "stiffness_matrix": extension.T @ (stiffness[:, None] * extension),
        }
        for value in arrays.values():
            value.setflags(write=False)
        tuples = {"contacts": tuple(self.contacts), "damping_terms": tuple(terms)}
        for name, derived in (arrays | tuples).items():
            object.__setattr__(self, name, derived)

    @property
    def n(self) -> int:
        """Number of masses (degrees of freedom)."""
        return self.mass.size

    @cached_property
    def stops(self) -> tuple[Contact, ...]:
        """The contacts as one-sided stops; "both" gives the left stop, then the right stop."""
        return tuple(stop for contact in self.contacts for stop in contact.one_sided())

    @cached_property
    def contact_masses(self) -> tuple[int, ...]:
        """Ascending numbers, counted from 0, of the masses with a contact."""
        return tuple(sorted({contact.index for contact in self.contacts}))

    @cached_property
    def compliance(self) -> Array:
        """Inverse (n, n) of the stiffness matrix of the chain: Σ 1/k_l over l <= min(i, j). Nothing
        cancels: every entry has full relative accuracy for any ratio of stiffnesses."""
        reach = np.cumsum(1.0 / self.stiffness)
        matrix: Array = np.minimum.outer(reach, reach)
        matrix.setflags(write=False)
        return matrix

    def __repr__(self) -> str:
        """Return the number of masses, the stops and the number of damping terms in one line."""
        stops = ", ".join(f"{stop.side} of mass {stop.mass}" for stop in self.stops) or "none"
        masses = "1 mass" if self.n == 1 else f"{self.n} masses"
        return f"System({masses}; stops: {stops}; damping terms: {len(self.damping_terms)})"

    def fact(self, compute: Callable[["System"], Fact]) -> Fact:
        """Return ``compute(self)``, stored in the system after the first call. ``compute``, a
        function of a module, is the key. An exception is not stored."""
        if compute not in self._facts:
            self._facts[compute] = compute(self)
        return cast("Fact", self._facts[compute])

    def __getstate__(self) -> dict[str, Any]:
        """Return the state to pickle, without the stored facts: they are computed again."""
        return {**self.__dict__, "_facts": {}}

    def contact_energy(self, mass: int, q: ArrayLike) -> Array:
        """Contact energy, Eq. (5), of ``mass``, from 0, at its displacements ``q`` of any shape."""
        q = np.asarray(q, dtype=float)
        energy = np.zeros_like(q)
        for stop in self.stops:
            if stop.index == mass:
                energy = energy + stop.energy(np.maximum(stop.sign * q - stop.clearance, 0.0))
        return energy

    def potential(self, q: ArrayLike) -> Array:
        """Potential V = ½ qᵀ K q + Σ U_i(q_i) (...) of Eq. (5) at ``q`` (..., n)."""
        q = np.asarray(q, dtype=float)
        springs: Array = 0.5 * np.einsum("...i,ij,...j->...", q, self.stiffness_matrix, q)
        return springs + sum(self.contact_energy(i, q[..., i]) for i in self.contact_masses)

    def hamiltonian(self, q: ArrayLike, p: ArrayLike) -> Array:
        """Hamiltonian ½ Σ p_i²/m_i + V(q) (...) of Eq. (5) at ``q`` and ``p``, (..., n) each."""
        p = np.asarray(p, dtype=float)
        kinetic: Array = 0.5 * np.sum(p * p / self.mass, axis=-1)
        return kinetic + self.potential(q)


def _finite(key: str, value: ArrayLike) -> Array:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        remedy = "must be numbers in a list, or lists of equal length"
        raise InvalidInput(key, value, remedy) from None
    require(np.isfinite(array).all(), key, value, "must hold finite numbers only")
    return array


def _matrix(key: str, value: ArrayLike) -> Array:
    array = _finite(key, value)
    if array.ndim == 1 and array.size:
        return np.diag(array)
    square = array.ndim == 2 and array.shape[0] == array.shape[1] and array.size > 0
    require(square, key, value, "must be a list of numbers or a square matrix")
    return array


def _refuse_negative(key: str, matrix: Array, words: str) -> None:
    symmetric = 0.5 * (matrix + matrix.T)
    eigenvalues: Array = np.sort(symmetric.diagonal())
    if np.count_nonzero(symmetric) > np.count_nonzero(eigenvalues):
        eigenvalues = np.asarray(np.linalg.eigvalsh(symmetric), dtype=float)
    fits = eigenvalues[0] >= -ROUND_OFF * np.abs(eigenvalues).max()
    require(fits, key, matrix, f"{words} the eigenvalue {eigenvalues[0]:.3g} < 0")


@dataclass(frozen=True)
class Effects:
    """Effects that act in a system: a hashable key, for which a stepper is compiled.

    ``masses`` is n; ``laws`` are sorted names; ``contact_masses`` count from 0; ``stops`` is the
    number of one-sided contacts and ``noise_rank`` the number of independent noises that reach a
    mass. ``correlated_noise``, ``coupled_damping``: f D fᵀ, or c, is not diagonal;
    ``state_damping``: the damping depends on the state; ``energy_damping``: it depends on H;
    ``mirror``: the system is invariant under q → −q.
    """

    masses: int
    laws: tuple[str, ...]
    contact_masses: tuple[int, ...]
    stops: int
    noise_rank: int
    correlated_noise: bool
    coupled_damping: bool
    state_damping: bool
    energy_damping: bool
    mirror: bool


def effects_of(system: System) -> Effects:
    """Return which effects act in ``system``."""
    noise = system.noise_matrix
    return Effects(
        masses=system.n,
        laws=tuple(sorted({stop.law for stop in system.stops})),
        contact_masses=system.contact_masses,
        stops=len(system.stops),
        noise_rank=int(np.linalg.matrix_rank(noise, hermitian=True)),
        correlated_noise=bool(np.any(noise != np.diag(np.diag(noise)))),
        coupled_damping=bool(np.any(system.damping != np.diag(np.diag(system.damping)))),
        state_damping=bool(system.damping_terms),
        energy_damping=any(term.energy for term in system.damping_terms),
        mirror=looks_the_same_mirrored(system),
    )


def looks_the_same_mirrored(system: System) -> bool:
    """Return whether stops and damping terms are invariant under (q, p) → (−q, −p)."""
    stops = [(s.index, s.stiffness, s.clearance, s.law, s.power, s.side) for s in system.stops]
    right, left = (sorted(s[:-1] for s in stops if s[-1] == side) for side in ("right", "left"))
    return right == left and all(term.degree % 2 == 0 for term in system.damping_terms)
