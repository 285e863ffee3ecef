"""Which effects act in a system: derived from it, never declared a second time."""

from dataclasses import dataclass

import numpy as np

from fpk.system import System


@dataclass(frozen=True)
class Effects:
    """The effects of one system; hashable, and the key by which the stepper is compiled.

    ``laws`` are the contact laws that act, sorted; ``contact_masses`` count from 0; ``stops`` is
    the number of one-sided contacts; ``noise_rank`` the number of independent noises that reach
    a mass; ``state_damping`` whether the damping depends on the state, ``energy_damping`` whether
    on H among it; ``mirror`` whether the system looks the same under q → −q.
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

    @property
    def contact(self) -> bool:
        """Whether any mass can touch anything."""
        return self.stops > 0


def effects_of(system: System) -> Effects:
    """Return the effects that act in ``system``."""
    stops = system.stops
    noise = system.noise_matrix
    return Effects(
        masses=system.n,
        laws=tuple(sorted({stop.law for stop in stops})),
        contact_masses=system.contact_masses,
        stops=len(stops),
        noise_rank=int(np.linalg.matrix_rank(noise, hermitian=True)),
        correlated_noise=bool(np.any(noise != np.diag(np.diag(noise)))),
        coupled_damping=bool(np.any(system.damping != np.diag(np.diag(system.damping)))),
        state_damping=bool(system.damping_terms),
        energy_damping=any(term.energy for term in system.damping_terms),
        mirror=looks_the_same_mirrored(system),
    )


def looks_the_same_mirrored(system: System) -> bool:
    """Whether the system is the same under q → −q."""
    right, left = (
        sorted(
            (s.index, s.stiffness, s.clearance, s.law, s.power)
            for s in system.stops
            if s.side == side
        )
        for side in ("right", "left")
    )
    return right == left and all(term.degree % 2 == 0 for term in system.damping_terms)
