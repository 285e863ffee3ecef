"""The report of a simulation, as typed records; tables and JSON show it as ``settings``."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Literal

from fpk.answer.density import AnyDensity
from sim.sample.diagnostics import Diagnosis

Settings = dict[str, str | float | int]


@dataclass(frozen=True)
class Steps:
    """How far the states were advanced; times in the unit of time of the system.

    ``dt`` is the step of the integrator; ``paths`` were sampled for ``time`` after ``burn_in``, in
    ``steps`` of ``long_step``, every ``stride``-th of them observed. ``relaxation_time`` is the
    longest decay time without contact. ``small_steps`` says which trajectories make small steps,
    ``limited_by`` the limit that cut ``time`` short of what was asked for; empty where nothing.
    """

    dt: float
    paths: int
    time: float
    burn_in: float
    relaxation_time: float
    scheme: str
    steps: int
    stride: int
    batches: int
    seed: int
    threads: int
    kT: float
    long_step: float
    ns_per_particle_step: float
    small_steps: str
    limited_by: Literal["", "most_steps"]


@dataclass(frozen=True)
class StepBias:
    """The difference between the runs at dt and dt/2, and what sampling alone makes of it.

    Of a density: the L1 distance, and its mean were both densities the same. Of a moment: the
    difference, and its standard error. With weak order w it is ``1 − 2^−w`` of the bias at dt.
    """

    difference: float
    chance: float


@dataclass(frozen=True)
class Moment:
    """The mean of ``name`` over the sampled states, such as ``q2²``, and its standard error."""

    name: str
    mean: float
    error: float


@dataclass(frozen=True)
class Report:
    """Everything a simulation says of itself beside its densities.

    ``diagnosis`` is None where Ctrl-C ended the sampling, as ``interrupted`` then says, or the
    limit of time did, in its first chunk. ``step_pair`` says whether a second simulation at half
    the step could be compared, and ``step_biases`` has what that gave, by the names of the
    densities (such as ``q2,p2``) and of the moments.
    """

    steps: Steps
    diagnosis: Diagnosis | None = None
    moments: tuple[Moment, ...] = ()
    interrupted: str = ""
    step_pair: str = "not measured"
    step_biases: Mapping[str, StepBias] = field(default_factory=dict)

    def settings(self, densities: Sequence[AnyDensity]) -> Settings:
        """Return everything, errors of ``densities`` too, by the names of tables and JSON."""
        settings: Settings = {
            key: value for key, value in asdict(self.steps).items() if value != ""
        }
        if self.interrupted:
            settings["partial"] = self.interrupted
        if self.diagnosis is not None:
            settings |= self.diagnosis.settings()
        settings |= {f"sampling error of {d.name}": d.l1_error for d in densities}
        if densities:
            settings["sampling error"] = (
                "expected L1 error of the density as it is returned at points; tol is of the same"
            )
        for m in self.moments:
            settings |= {f"E {m.name}": m.mean, f"standard error of E {m.name}": m.error}
        settings["step bias"] = self.step_pair
        named = [(d.name, d.name, "{} by chance") for d in densities]
        named += [(m.name, f"E {m.name}", "standard error of {}") for m in self.moments]
        for key, of, chance in named:
            if bias := self.step_biases.get(key):
                name = f"step bias of {of}"
                settings |= {name: bias.difference, chance.format(name): bias.chance}
        return settings
