"""A folder in which one run, or one map, stores the states or points that it continues from."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cases.scene.errors import BadInput
from cases.scene.scene import read_text
from cases.show.files import make_folder, write_text
from cases.show.records import Record, program_version
from fpk.numeric.machine import lock_file
from fpk.numeric.recognition import canonical
from sim.sample.workers import program_checksum


@contextmanager
def claim_folder(folder: Path | None, identity: Record) -> Iterator[None]:
    """Return a context in which this process alone stores states or points in ``folder``.

    None: nothing is done. The folder is made if missing, and its file ``run.json`` with all that
    the stored results depend on: ``identity``, the version and a checksum of the program's sources.
    Raises ``Unavailable`` if another process uses the folder or it cannot be locked, ``BadInput``
    if its ``run.json`` differs or it cannot be written.
    """
    if folder is None:
        yield
        return
    path = make_folder(folder) / "run.json"
    program = {"version": program_version(), "sources": program_checksum()}
    record = canonical({**identity, **program})
    text = json.dumps(record, ensure_ascii=False) + "\n"
    with lock_file(folder / "run.lock"):
        if not path.exists():
            write_text(path, text)
        elif read_text(path, str(path), most=1 << 24, what="the run's identity") != text:
            raise BadInput(
                f"{folder}: holds what another run has stored (other scene, settings or version);"
                " give another folder or remove it"
            )
        yield
