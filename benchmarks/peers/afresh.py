"""Systems of scenes that remember nothing of an earlier solve."""

from dataclasses import replace
from functools import lru_cache

from cases.scene.scene import load_scene
from fpk.system.system import System


@lru_cache
def _read(scene: str) -> System:
    return load_scene(scene).system


def afresh(scene: str) -> System:
    """Return the system of a shipped scene, a new one each time; its file is read once."""
    return replace(_read(scene))
