"""How many processor cores this process may use."""

import os


def usable_cores() -> int:
    """Return the cores that this process may run on; all there are where the system can't say."""
    affinity = getattr(os, "sched_getaffinity", None)  # Linux only
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1
