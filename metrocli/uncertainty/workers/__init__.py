"""Workers for the chunks of a long computation: threads of this process, or a Dask cluster.

A chunk is a pure function of its number, so the outcome does not depend on the workers.

Method: docs/algorithms/monte-carlo-chunks.md.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from metrocli.frozen import dataclass
from metrocli.uncertainty.workers.dask_cluster import ordered_on, with_help

T = TypeVar("T")


class Finished:
    """Store of chunks that an earlier run has finished, by the key of the computation and their number; it keeps none.

    A subclass keeps them.
    """

    def get(self, key: str, number: int) -> dict[str, Any] | None:
        """Return the stored arrays of a chunk, or None."""
        return None

    def put(self, key: str, number: int, value: dict[str, Any]) -> None:
        """Store the arrays of a finished chunk."""

    def clear(self) -> None:
        """Remove all chunks, after the computation is complete."""


@dataclass(frozen=True)
class Workers:
    """Where chunks are computed: threads or a Dask cluster, with progress and store."""

    count: int = 0
    """Number of threads; 0 for one per core"""
    scheduler: str = ""
    """Address of a Dask scheduler, tcp://..., or the path of its scheduler file; "" for this process"""
    helped: bool = False
    """Whether this is a task on a Dask cluster, and the other workers share what takes long"""
    finished: Finished = Finished()
    tell: Callable[[int, int | None], None] = lambda done, of: None
    """Progress function: takes the number of finished chunks and the total"""

    def ordered(self, work: Callable[[int], T], numbers: Iterable[int]) -> Iterator[T]:
        """Yield work(number) in the order of the numbers, while workers compute later ones in advance."""
        if self.scheduler:
            with ordered_on(self.scheduler) as ordered:
                yield from ordered(work, numbers)
        elif self.helped:
            yield from with_help(work, numbers)
        elif self.threads == 1:
            yield from map(work, numbers)
        else:
            yield from _on_threads(self.threads, work, numbers)

    @property
    def threads(self) -> int:
        """Threads that work at once."""
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        return self.count or cores


def _on_threads(count: int, work: Callable[[int], T], numbers: Iterable[int]) -> Iterator[T]:
    from concurrent.futures import ThreadPoolExecutor

    pool = ThreadPoolExecutor(count)
    try:
        yield from _window(lambda number: pool.submit(work, number), numbers, 2 * count)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _window(submit: Callable[[int], Any], numbers: Iterable[int], most: int) -> Iterator[Any]:
    """Yield results in order, with at most `most` of them in progress."""
    # in order, so that sums have the same rounding and an adaptive run stops at the same chunk for any count
    waiting: deque[Any] = deque()
    for number in numbers:
        waiting.append(submit(number))
        if len(waiting) >= most:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()
