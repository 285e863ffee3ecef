"""The report of a simulation, as typed records; tables and JSON show it as ``settings``."""

from dataclasses import asdict, dataclass
from math import nan
from typing import Literal

from fpk.observable import Observable, observable_name
from sim.diagnostics import Diagnosis

Settings = dict[str, str | float | int]

SHOWN_AS = {
    "temperature": "kT",
    "nanoseconds": "ns_per_particle_step",
    "division": "small_steps",
}
"""Keys of ``Steps`` in tables and JSON, where they differ from the names of its fields."""


@dataclass(frozen=True)
class Steps:
    """How the states were advanced and sampled; times in the unit of time of the system.

    ``dt`` is the step of the integrator; ``long_step`` holds ``small`` of them, which only
    trajectories near a stop make one by one, and ``division`` says why so many. ``steps`` long
    steps of each of ``paths`` trajectories, together ``time``, were sampled every ``stride``-th
    after ``burn_in``. ``temperature`` is kT, ``relaxation_time`` the longest decay time without
    contact, ``nanoseconds`` the processor time per trajectory and long step. ``limited_by`` names
    the limit that cut the sampled time short of what was asked for.
    """

    scheme: str
    dt: float
    paths: int
    steps: int
    time: float
    burn_in: float
    stride: int
    batches: int
    seed: int
    threads: int
    temperature: float
    long_step: float
    nanoseconds: float
    relaxation_time: float
    small: int = 1
    division: str = ""
    limited_by: Literal["", "most_steps"] = ""


@dataclass(frozen=True)
class StepBias:
    """The difference between the runs at dt and dt/2, and what sampling alone makes of it.

    Of a density: the L1 distance, and its mean were both densities the same. Of a moment: the
    difference, and one standard error of it. With weak order w it is ``1 − 2^−w`` of the bias at
    dt: 15/16 of it for ``exact_flow``.
    """

    difference: float
    chance: float


@dataclass(frozen=True)
class DensityError:
    """The expected L1 sampling error of one density, and its step bias where it was measured."""

    observable: Observable
    sampling: float
    step_bias: StepBias | None = None

    @property
    def name(self) -> str:
        """The observable's name, such as ``q2,p2``."""
        return observable_name(self.observable)


@dataclass(frozen=True)
class Moment:
    """The mean of ``name`` over the sampled states, such as ``q2²``, in the unit of the system.

    ``error`` is one standard error, from the means of single trajectories; ``effective_samples``
    the number of independent samples of equal worth, not a number where it was not estimated.
    """

    name: str
    mean: float
    error: float
    effective_samples: float = nan
    step_bias: StepBias | None = None


@dataclass(frozen=True)
class Report:
    """Everything a simulation says of itself beside its densities.

    ``errors`` are in the order of the densities. ``diagnosis`` is None where there was nothing to
    diagnose: trajectories were ``lost`` (left the finite range), or Ctrl-C ended the sampling, as
    ``interrupted`` then says. ``step_pair`` says whether a second simulation at half the step could
    be compared.
    """

    steps: Steps
    errors: tuple[DensityError, ...] = ()
    diagnosis: Diagnosis | None = None
    moments: tuple[Moment, ...] = ()
    interrupted: str = ""
    lost: int = 0
    step_pair: str = "not measured"

    def error_of(self, observable: Observable) -> DensityError:
        """Return the errors of the density of ``observable``, one of those asked for."""
        return next(error for error in self.errors if error.observable == observable)

    def settings(self) -> Settings:
        """Return everything for readers, by the names that tables and JSON have."""
        steps = asdict(self.steps) | {"small": ""}  # ``division`` has it in words
        settings: Settings = {SHOWN_AS.get(k, k): v for k, v in steps.items() if v != ""}
        if self.interrupted:
            settings["partial"] = self.interrupted
        if self.diagnosis is not None:
            settings |= self.diagnosis.settings()
        settings |= {f"sampling error of {e.name}": e.sampling for e in self.errors}
        for m in self.moments:
            settings |= {f"E {m.name}": m.mean, f"standard error of E {m.name}": m.error}
        settings["step bias"] = self.step_pair
        for e in self.errors:
            if e.step_bias is not None:
                name = f"step bias of {e.name}"
                settings |= {name: e.step_bias.difference, f"{name} by chance": e.step_bias.chance}
        for m in self.moments:
            if m.step_bias is not None:
                name, bias = f"step bias of E {m.name}", m.step_bias
                settings |= {name: bias.difference, f"standard error of {name}": bias.chance}
        return settings
