"""The folder of ``--checkpoint``: states of one run of one scene, never of two."""

import json
from pathlib import Path
from typing import Any

from cases.output.files import make_folder, write_text
from cases.output.records import hash_of, plain, program_version
from cases.scene.errors import BadInput
from cases.scene.scene import Scene

NAME = "run.json"


def checkpoint_folder(folder: Path | None, scene: Scene, settings: dict[str, Any]) -> Path | None:
    """Return the folder, made where it is missing, None where there is none asked for.

    Raises ``BadInput`` where it holds states of another scene, other settings or another version.
    """
    if folder is None:
        return None
    identity = {"scene": scene.text, "settings": settings, "version": program_version()}
    record = {"run": hash_of(identity), "identity": plain(identity)}
    path = make_folder(folder) / NAME
    try:
        run = json.loads(path.read_text(encoding="utf-8"))["run"]
    except FileNotFoundError:
        write_text(path, json.dumps(record, ensure_ascii=False) + "\n")
        return folder
    except (OSError, ValueError, KeyError, TypeError):
        raise BadInput(f"{path}: cannot be read; give another --checkpoint") from None
    if run != record["run"]:
        raise BadInput(
            f"{folder}: holds states of another run (other scene, settings or version);"
            " give another --checkpoint or remove it"
        )
    return folder
