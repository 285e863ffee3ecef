"""Settings of splitting, and what it returns."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fpk.arrays import Array
from sim.montecarlo import check_settings
from sim.splitting.arrays import MOST_REPLICAS

LEAST_REPETITIONS = 8
"""Repetitions below which their spread says too little of the error."""

NOT_IN_REPETITION = {
    "Splitting.threads": "the random numbers belong to a repetition",
    "Splitting.cluster": "wherever it is made",
    "Splitting.checkpoint": "it says where the repetitions are stored",
    "Splitting.partial": "it says what Ctrl-C does, after which one goes on",
    "Splitting.repetitions": "it says how many are made, each of which is numbered",
    "Splitting.tol": "so does this",
    "Splitting.seconds": "and this",
}
"""Fields on which a finished repetition does not depend."""


@dataclass(frozen=True)
class Splitting:
    """How rare failure is sampled; times in the unit of time of the system, but for ``seconds``.

    A repetition has so many ``replicas``, of which each level kills ``killed`` at least.
    ``repetitions`` are made at the step dt and as many at dt/2, then as many again until the
    relative error is ``tol`` or ``seconds`` of wall time have passed; without ``tol`` no more are
    made. ``dt`` None: that of the system. ``threads``, ``cluster``, ``checkpoint`` and ``partial``
    as of ``MonteCarlo``: the numbers depend on none of them.

    A small one::

        Splitting(replicas=64, repetitions=8, seed=1)

    Raises ``InvalidInput`` naming the field that cannot be used.
    """

    replicas: int = 512
    killed: int = 32
    repetitions: int = 16
    seed: int = 1
    dt: float | None = None
    tol: float | None = None
    seconds: float = 60.0
    threads: int | None = None
    cluster: str | None = None
    checkpoint: Path | None = None
    partial: bool = False

    def __post_init__(self) -> None:
        """Check every field."""
        check_settings(
            self,
            ("dt", "tol", "seconds"),
            ("replicas", 2, MOST_REPLICAS),
            ("killed", 1, self.replicas - 1),
            ("repetitions", LEAST_REPETITIONS, 2**20),
        )


@dataclass(frozen=True)
class RareFailure:
    """The probability that a limit is passed before a time, and how well it is known.

    ``probability`` is the mean of ``values`` (repetitions,) at the step ``dt``; ``error`` is one
    standard error of it and the difference ``bias`` of the mean at 2 dt from it, or the standard
    error of that if it is larger, added in squares. It is inf where the repetitions are so
    scattered that their mean may be off by more than they show: take more replicas.
    ``upper_bound`` holds with 95 % confidence. Where the error is inf it is that of the paths from
    the start alone; so it is where no replica has failed: the probability is then given as 0, with
    that bound as its error. ``sampling_error`` and ``bias_error`` are standard errors; ``extinct``
    repetitions had no replica left.
    ``levels`` is the mean number of levels, ``steps`` all that were simulated, ``seconds`` their
    wall time. ``log_probability`` is right where the probability is too small to be a number. ::

        settings = Splitting(replicas=64, repetitions=8, seed=1)
        rare = rare_failure(system, parse_limit("H=2", 2), REST, 5.0, settings=settings)
        rare.probability, rare.error, rare.upper_bound
    """

    probability: float
    error: float
    upper_bound: float
    log_probability: float
    sampling_error: float
    bias: float
    bias_error: float
    values: Array
    extinct: int
    levels: float
    dt: float
    steps: int
    seconds: float
    settings: Mapping[str, str | float | int] = field(default_factory=dict)

    @property
    def relative_error(self) -> float:
        """The error in units of the probability; inf where that is 0."""
        return self.error / self.probability if self.probability > 0.0 else float("inf")
