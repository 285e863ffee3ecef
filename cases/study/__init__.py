"""Studies of a scene: convergence, cost, maps and sweeps; and the registry of own studies.

A study says what varies, what is measured, and which order theory predicts: these are the fields of
a ``cases.study.levels.Study``. One file adds a command ``fpk NAME SCENE`` with its tables, pictures
and JSON; ``register_study`` is called when the file is imported::

    def doubled_points(scene, seed):
        return [Study("mass of p", Discretisation(...), count=6, measure=..., theory={"mass": 2.0},
                      floor={"mass": 1e-15})]

    register_study(OwnStudy("trapezoid", "Measure the order of the rule.", doubled_points))

This file imports no numerical library: the command line reads it for its help.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cases.scene.scene import Scene
    from cases.study.levels import Study


@dataclass(frozen=True, eq=False)
class OwnStudy:
    """A command of its own ``name`` whose ``studies`` of a scene are all measured.

    The first error by name that a level has is drawn, against the unknowns. ``help`` is the text of
    the command. ``studies`` takes the scene and the seed of simulations; it may raise
    ``NotApplicable`` with the reason.
    """

    name: str
    help: str
    studies: "Callable[[Scene, int], Sequence[Study]]"


STUDIES: dict[str, OwnStudy] = {}
"""Registered studies by name."""


def register_study(study: OwnStudy) -> OwnStudy:
    """Add ``study`` to the commands of ``fpk`` and return it; replaces one of the same name."""
    STUDIES[study.name] = study
    return study
