"""The folder of ``--checkpoint``: states of one run of one scene, never of two."""

import json
from collections.abc import Mapping
from typing import Any

from cases.output.files import make_folder, write_text
from cases.output.records import hash_of, plain, program_version
from cases.scene.errors import BadInput
from cases.scene.scene import Scene

SETTINGS = ("seed", "tol", "dt", "step_pair", "observable")
"""Settings of a command that a saved state of its simulation depends on."""


def checkpoint_folder(scene: Scene, settings: Mapping[str, Any]) -> None:
    """Make the folder ``settings["checkpoint"]`` where it is asked for and missing.

    Raises ``BadInput`` where it holds states of another scene, other settings or another version.
    """
    folder = settings["checkpoint"]
    if folder is None:
        return
    own = {key: settings[key] for key in SETTINGS if key in settings}
    identity = {"scene": scene.text, "settings": own, "version": program_version()}
    record = {"run": hash_of(identity), "identity": plain(identity)}
    path = make_folder(folder) / "run.json"
    try:
        run = json.loads(path.read_text(encoding="utf-8"))["run"]
    except FileNotFoundError:
        write_text(path, json.dumps(record, ensure_ascii=False) + "\n")
        return
    except (OSError, ValueError, KeyError, TypeError):
        raise BadInput(f"{path}: cannot be read; give another --checkpoint") from None
    if run != record["run"]:
        raise BadInput(
            f"{folder}: holds states of another run (other scene, settings or version);"
            " give another --checkpoint or remove it"
        )
