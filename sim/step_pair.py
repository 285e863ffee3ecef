"""Means of a run as settings, and how far those of a run with half the step lie from them.

The difference between the runs at dt and dt/2 is ``1 − 2^−w`` of the bias at dt, w being the
weak order: 15/16 of it for ``exact_flow``. It is told as it is, beside what chance makes of it.
"""

from math import hypot

from sim.control import (
    FALSE_ALARMS,
    ControlledMean,
    PathMeans,
    displacement_square,
    velocity_square,
)
from sim.simulation import Simulation
from sim.statistics import l1_difference, told

Settings = dict[str, str | float | int]


def controlled_means(paths: PathMeans) -> dict[str, ControlledMean]:
    """Return E q_i² and E v_i², plain and by control variates, by name, masses from 1."""
    found = {}
    for i in range(paths.system.n):
        found[f"q{i + 1}²"] = displacement_square(paths, i)
        found[f"v{i + 1}²"] = velocity_square(paths, i)
    return found


def mean_settings(paths: PathMeans) -> Settings:
    """Return the mean of the states with its standard error, and by control variates beside it.

    "E q2²" is that of the states, as in the histograms. The other is told only where its controls
    hold, and with it what a bias of theirs that this run cannot see may be (``sim.control``).
    """
    settings: Settings = {}
    refused = []
    for name, mean in controlled_means(paths).items():
        settings[f"E {name}"] = mean.plain.value
        settings[f"standard error of E {name}"] = mean.plain.error
        if not mean.held:
            refused.append(f"{name} ({mean.chance:.1g})")
            continue
        by = f"E {name} by control variates"
        settings[by] = mean.value
        settings[f"standard error of {by}"] = mean.error
        settings[f"unseen bias of {by}"] = mean.unseen
        settings[f"variance gain of {by}"] = mean.gain
    said = "their means differ from those of the continuous system, by the step or the burn-in"
    settings["control variates"] = (
        f"not used for {', '.join(refused)}: {said}; in brackets how often chance does that"
        if refused
        else f"used: their means hold within chance (refused falsely once in {1 / FALSE_ALARMS:g})"
    )
    return settings


def step_bias(run: Simulation, half: Simulation) -> Settings:
    """Return L1 differences of the densities and differences of the means, run minus ``half``.

    "chance" of a density is the L1 distance that sampling alone leaves on average, "error" of a
    mean the standard error of its difference. Means are those of the states: controls would take
    some of the bias away that is asked for.
    """
    settings: Settings = {"step bias": "dt against dt/2"}
    for a, b in zip(run.densities, half.densities, strict=True):
        distance, chance = l1_difference(told(a), told(b))
        settings[f"step bias of {a.name}"] = distance
        settings[f"step bias of {a.name} by chance"] = chance
    if half.lost:
        settings["step bias"] = f"{half.lost} trajectories left the finite range at dt/2"
    elif run.paths is not None and half.paths is not None:
        others = controlled_means(half.paths)
        for name, mean in controlled_means(run.paths).items():
            settings[f"step bias of E {name}"] = mean.plain.value - others[name].plain.value
            error = hypot(mean.plain.error, others[name].plain.error)
            settings[f"standard error of step bias of E {name}"] = error
    return settings
