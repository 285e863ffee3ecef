"""The observed states of all lanes, handed out as they are."""

from fpk.arrays import Array
from fpk.compiling import inlined
from sim.arrays import WatchArrays
from sim.lanes import copy, row


@inlined
def trace_state(s: Array, trace: Array, watch: WatchArrays, sample: int) -> None:
    """Copy the rows ``watch.traced`` of a block to number ``sample`` of its ``trace``."""
    rows = watch.traced.size
    for r in range(rows):
        copy(row(trace, sample * rows + r), row(s, watch.traced[r]))
