"""An ensemble on a Dask cluster: shares of it are tasks, and their results add up.

A share is a range of blocks, its state a future, and every step forward a task that is a pure
function of the future before. When a worker dies Dask computes what it held again from the tasks
that led there; streams are keyed by trajectory, counts are integers, and sums are put together in
the order of blocks: the answer is bitwise that of one machine (of the same kind of processor),
however many shares and workers there are.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, partial
from importlib import import_module
from itertools import pairwise
from operator import attrgetter
from typing import Any, NamedTuple
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from fpk.errors import NotCertified, Unavailable
from fpk.system import System
from sim.arrays import LANES
from sim.ensemble import (
    Ensemble,
    Integers,
    Product,
    Saved,
    batch_edges,
    batch_range,
    block_count,
    means_of_batches,
)
from sim.histogram import Histogram, starts
from sim.scheme import Scheme
from sim.sources import program_checksum

Array = NDArray[np.float64]

PATIENCE = 10.0
"""Seconds in which the scheduler must answer."""

WORKERS_IN = 60.0
"""Seconds in which it must have a worker."""

SHARES_PER_THREAD = 2
"""Shares, in units of the threads of the cluster: what a dead worker held is spread over others."""


@cache
def package(name: str) -> Any:
    """Return a package of the extra ``cluster``, imported when it is wanted: it takes a second."""
    return import_module(name)


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """Yield a client of the Dask scheduler at ``address`` that has a worker.

    Raises ``Unavailable`` where dask is missing, nothing answers, or no worker of the same
    program is there.
    """
    try:
        client = package("distributed").Client(address, timeout=PATIENCE, set_as_default=False)
    except ImportError:
        raise Unavailable(
            f"cluster {address}: needs dask, the extra: pip install 'vibro-fpk[cluster]'"
        ) from None
    except (OSError, ValueError, RuntimeError, TypeError) as error:
        words = f"no Dask scheduler answers ({type(error).__name__}); give tcp://HOST:PORT"
        raise Unavailable(f"cluster {address}: {words}") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKERS_IN)
            stamp = client.submit(program_checksum, pure=False).result()
        except TimeoutError:
            raise Unavailable(f"cluster {address}: has no worker; start one") from None
        except ImportError as error:
            words = f"its workers cannot import this program ({error}); install vibro-fpk there"
            raise Unavailable(f"cluster {address}: {words}") from None
        if stamp != program_checksum():
            words = "its workers run another version of this program; install the same"
            raise Unavailable(f"cluster {address}: {words}")
        yield client


def gathered(client: Any, futures: Sequence[Any]) -> list[Any]:
    """Return the results of ``futures``; ``NotCertified`` when the cluster is lost on the way."""
    distributed = package("distributed")
    try:
        return list(client.gather(list(futures)))
    except (distributed.KilledWorker, distributed.CancelledError, OSError) as error:
        words = " ".join(f"{type(error).__name__} {error}".split())
        raise NotCertified(f"the cluster was lost on the way: {words[:200]}") from None


def as_finished(client: Any, tasks: Sequence[Callable[[], Any]]) -> Iterator[Any]:
    """Yield what pure tasks without arguments return, in the order in which they are finished."""
    futures = [client.submit(task, pure=False) for task in tasks]
    for future in package("distributed").as_completed(futures, loop=client.loop):
        yield gathered(client, [future])[0]


@contextmanager
def ensembles(address: str | None) -> Iterator[Callable[..., Any]]:
    """Yield what makes ensembles: ``Ensemble`` here, or on the cluster at ``address``."""
    if address is None:
        yield Ensemble
        return
    with connected(address) as client:
        yield partial(ClusterEnsemble, client)


def after(share: Ensemble, method: str, *arguments: Any, **named: Any) -> Ensemble:
    """Return what becomes of a share; the share given stays as it is."""
    share = share.copied()
    getattr(share, method)(*arguments, **named)
    return share


class ShareState(NamedTuple):
    """Losses, sums and counts of a share between two chunks: small beside its trajectories."""

    lost: int
    sums: Array  # (blocks, products)
    batch: int  # the first one of which it has some blocks
    counts: Integers


def state_of(share: Ensemble) -> ShareState:
    """Return losses, sums and counts of a share."""
    return ShareState(share.lost(), share.block_sums(), share.batch, share.counts)


@dataclass(eq=False)
class ClusterEnsemble:
    """``paths`` trajectories on the workers of ``client``; the face is that of ``Ensemble``.

    ``threads`` is replaced by that of all workers; a task uses one of them, and a worker with
    several works on as many shares at once. Histograms come here when they are asked for only.
    """

    client: Any
    system: System
    scheme: Scheme
    dt: float
    paths: int
    seed: int
    threads: int
    done: int = 0
    samples: int = 0
    bounds: Integers = field(init=False)  # first block of each share, and the number of blocks

    def __post_init__(self) -> None:
        """Start the shares, each where its task happens to run."""
        self.threads = max(1, sum(self.client.nthreads().values()))
        blocks = block_count(self.paths)
        shares = min(blocks, SHARES_PER_THREAD * self.threads)
        self.bounds = np.arange(shares + 1, dtype=np.int64) * blocks // shares
        self.edges = batch_edges(self.paths)
        self.live = np.minimum(LANES, self.paths - LANES * np.arange(blocks))
        self._job, self._round, self.phase = uuid4().hex, 0, 0
        self._width = 0
        self._known: Sequence[ShareState] | None = None
        whole = (self.system, self.scheme, self.dt, self.paths, self.seed, 1)
        parts = pairwise(self.bounds.tolist())
        self._shares = self._submitted(Ensemble, [(*whole, part) for part in parts])

    def watch(self, histograms: Sequence[Histogram] = (), products: Sequence[Product] = ()) -> None:
        """Observe these from now on, all counts and sums starting from zero."""
        self._next("watch", tuple(histograms), tuple(products))
        self._width = int(starts(histograms)[-1])
        self.samples = self.phase = 0

    def advance(self, steps: int, *, stride: int = 1) -> None:
        """Advance all trajectories, and wait for it; every ``stride``-th step is observed."""
        self._next("advance", steps, stride=stride)
        with self.client.as_current():
            package("distributed").wait(self._shares)
        if stride:
            self.samples += -(-(self.phase + steps) // stride) - -(-self.phase // stride)
            self.phase += steps
        self.done += steps

    def phase_points(self, most: int | None = None) -> tuple[Array, Array]:
        """Return the states (paths, n) of q and p just before the next kick, the first ``most``.

        Only shares that have some of them are asked.
        """
        paths = self.paths if most is None else min(self.paths, most)
        left = paths - LANES * self.bounds[:-1]
        calls = [(s, int(k)) for s, k in zip(self._shares, left, strict=True) if k > 0]
        answers = gathered(self.client, self._submitted(Ensemble.phase_points, calls))
        q, p = zip(*answers, strict=True)
        return np.concatenate(q), np.concatenate(p)

    def lost(self) -> int:
        """Return how many trajectories have left the finite range."""
        return sum(part.lost for part in self._states())

    def batch_means(self) -> Array:
        """Return (batches, products) means over the samples of each batch, in fixed order."""
        sums = np.concatenate([part.sums for part in self._states()])
        return means_of_batches(sums, self.edges, self.live, self.samples)

    @property
    def sums(self) -> Array:
        """Sums (first blocks, products, LANES) of all shares, side by side."""
        return np.concatenate(self._answers(attrgetter("sums")))

    @property
    def folded(self) -> Array:
        """Sums (other blocks, products, FOLDED) of all shares, side by side."""
        return np.concatenate(self._answers(attrgetter("folded")))

    @property
    def counts(self) -> Integers:
        """Counts (batches, bins) of all shares together."""
        return self.counted(0, self._width)

    def counted(self, first: int, end: int) -> Integers:
        """Return the counts of the bins from ``first`` to before ``end``, of each batch."""
        total = np.zeros((self.edges.size - 1, end - first), dtype=np.int64)
        for part in self._states():
            rows = slice(part.batch, part.batch + part.counts.shape[0])
            total[rows] += part.counts[:, first:end]
        return total

    def saved(self) -> Saved:
        """Return all that changes, as ``Ensemble.saved`` does."""
        return {
            "states": np.concatenate(self._answers(attrgetter("states"))),
            "sums": self.sums,
            "folded": self.folded,
            "counts": self.counts,
            "clock": np.array([self.done, self.samples, self.phase], dtype=np.int64),
        }

    def restore(self, saved: Saved) -> None:
        """Go on from what ``saved`` returned, here or there, after the same calls of ``watch``."""
        self.done, self.samples, self.phase = (int(number) for number in saved["clock"])
        parts, apart = [], saved["sums"].shape[0]
        for first, end in pairwise(self.bounds.tolist()):
            low, beyond = batch_range(self.edges, first, end)
            counts = saved["counts"][low:beyond].copy()
            if self.edges[low] < first:  # the share before has this batch's counts
                counts[0] = 0
            part = {name: saved[name][first:end] for name in ("states", "sums")}
            part["folded"] = saved["folded"][max(0, first - apart) : max(0, end - apart)]
            parts.append({**part, "counts": counts, "clock": saved["clock"]})
        calls = list(zip(self._shares, ["restore"] * len(parts), parts, strict=True))
        with package("dask").config.set(
            {"distributed.admin.large-graph-warning-threshold": "1PiB"}
        ):
            self._step(calls)

    def _states(self) -> Sequence[ShareState]:
        """Losses, sums and counts of the shares, asked for once a step: a round trip is slow."""
        if self._known is None:
            self._known = self._answers(state_of)
        return self._known

    def _next(self, method: str, *arguments: Any, **named: Any) -> None:
        self._step([(share, method, *arguments) for share in self._shares], **named)

    def _step(self, calls: Sequence[tuple[Any, ...]], **named: Any) -> None:
        self._shares = self._submitted(after, calls, **named)
        self._known = None

    def _answers(self, question: Callable[..., Any], *arguments: Any) -> list[Any]:
        calls = [(share, *arguments) for share in self._shares]
        return gathered(self.client, self._submitted(question, calls))

    def _submitted(self, task: Any, calls: Sequence[tuple[Any, ...]], **named: Any) -> list[Any]:
        """One future a call; keys are never used twice."""
        self._round += 1
        key = f"fpk-{self._job}-{self._round}"
        return [
            self.client.submit(task, *call, **named, key=f"{key}-{number}")
            for number, call in enumerate(calls)
        ]
