"""A Dask cluster that runs already: is it there, is it the same metrocli, and what it makes of numbers, in order.

Method: docs/algorithms/monte-carlo-chunks.md.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from typing import Any, Generic, TypeVar

from metrocli import __version__
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.uncertainty.workers.dask_client import PATIENCE_S, client_of

T = TypeVar("T")
PATIENCE_WITH_WORKERS_S = 60.0
"""Longest time until the first worker of a cluster appears [s]"""
_TASK_S, _MOST_AT_ONCE = 1.0, 25
"""Time that a task of a cluster should take [s], so that sending it does not count, and the most numbers in one"""


@contextmanager
def cluster(address: str, more: Callable[[], str] | None = None) -> Iterator[Any]:
    """Yield a client of a Dask cluster that has workers; raises InputError without them or if their versions differ.

    `more` states in words what else must be the same there as here.
    """
    client = client_of(address)
    try:
        _await_worker(client, address)
        _refuse_other_versions(client, address, more)
        yield client
    finally:
        client.close()


def first_finished(client: Any, futures: set[Any]) -> set[Any]:
    """Return the futures that are finished, at least one.

    Raises ConnectionError if the scheduler does not answer, or has had no worker for PATIENCE_WITH_WORKERS_S.
    """
    import distributed

    library: Any = distributed
    with_workers = time.monotonic()
    while True:
        try:
            done: set[Any] = library.wait(futures, timeout=PATIENCE_S, return_when="FIRST_COMPLETED").done
            return done
        except (TimeoutError, library.TimeoutError):
            if client.status != "running":
                raise ConnectionError("the scheduler does not answer") from None
            if client.nthreads():
                with_workers = time.monotonic()
            elif time.monotonic() - with_workers > PATIENCE_WITH_WORKERS_S:
                raise ConnectionError("the scheduler has lost all workers") from None


@contextmanager
def ordered_on(
    address: str, more: Callable[[], str] | None = None
) -> Iterator[Callable[[Callable[[int], Any], Iterable[int]], Iterable[Any]]]:
    """Yield what `map` does with a function and numbers, on a cluster; without an address yield `map` itself.

    `more` is that of `cluster`. Raises InputError if the cluster cannot be used, or ends before the work does.
    """
    if not address:
        yield map
        return
    with cluster(address, more) as client:
        yield lambda work, numbers: _on_cluster(client, address, work, numbers, more)


def _on_cluster(
    client: Any, address: str, work: Callable[[int], T], numbers: Iterable[int], more: Callable[[], str] | None = None
) -> Iterator[T]:
    def finished(future: Any) -> _Done[T]:
        with ends_in_words(address, ""):
            first_finished(client, {future})
            done: _Done[T] = future.result()
        return done

    with ends_in_words(address, ""):
        scattered = client.scatter(work, broadcast=True, hash=False)
        threads = max(sum(client.nthreads().values()), 1)
    waiting: deque[Any] = deque()
    left, size, versions = iter(numbers), 1, Versions.here(more)
    while (batch := list(islice(left, size))) or waiting:
        if batch:
            waiting.append(client.submit(_do, scattered, batch, versions, pure=False))
        if not batch or len(waiting) >= 4 * threads:
            done = finished(waiting.popleft())
            yield from done.values
            if done.error is not None:
                raise done.error
            size = min(max(int(len(done.values) * _TASK_S / max(done.seconds, 1e-3)), 1), _MOST_AT_ONCE)


def with_help(work: Callable[[int], T], numbers: Iterable[int], alone_s: float = 2.0) -> Iterator[T]:
    """Yield work(number) in order, within a task of a cluster: for a time [s] here, then by all its workers."""
    left, begun = iter(numbers), time.monotonic()
    for number in left:
        yield work(number)
        if time.monotonic() - begun > alone_s:
            break
    else:
        return
    import distributed

    library: Any = distributed
    # meanwhile this task takes no thread of its worker: tasks that wait for others could else wait for ever
    with library.worker_client() as client:
        yield from _on_cluster(client, client.scheduler.address, work, left)


@contextmanager
def ends_in_words(address: str, kept: str) -> Iterator[None]:
    """Raise InputError, with what is `kept`, for any way in which the library reports that the cluster has gone."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        message = f"--scheduler {address}: the cluster has ended ({type(error).__name__}); {kept}run again to go on"
        raise InputError(message) from error


def _await_worker(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=PATIENCE_WITH_WORKERS_S)
    except TimeoutError as error:
        raise InputError(
            f"--scheduler {address}: the scheduler has no workers after {PATIENCE_WITH_WORKERS_S:g} s; start some"
        ) from error


def _refuse_other_versions(client: Any, address: str, more: Callable[[], str] | None) -> None:
    """Raise InputError if a worker could give other numbers than this process."""
    answers = client.run(_versions, more, on_error="return").values()
    # an OSError is that of a worker which has just died; the scheduler will drop it
    here = _versions(more)
    others = {str(answer) for answer in answers if not isinstance(answer, OSError)} - {here}
    if others:
        raise InputError(f"--scheduler {address}: {_unlike('; '.join(sorted(others)), here)}")


@dataclass(frozen=True)
class Versions:
    """What the process that asks a cluster has, and each worker that computes for it must have."""

    stated: str
    more: Callable[[], str] | None

    @classmethod
    def here(cls, more: Callable[[], str] | None) -> Versions:
        """Return those of this process; `more` as for `cluster`."""
        return cls(_versions(more), more)

    def require(self) -> None:
        """Raise InputError on a worker that has others: it joined after the first were asked."""
        there = _versions(self.more)
        if there != self.stated:
            raise InputError(f"the cluster: {_unlike(there, self.stated)}")


def _unlike(there: str, here: str) -> str:
    return f"workers have {there}, and this is {here}: install the same versions everywhere"


def _versions(more: Callable[[], str] | None) -> str:
    import platform

    import numpy as np

    python = ".".join(platform.python_version_tuple()[:2])
    versions = f"metrocli {__version__} with numpy {np.__version__} and Python {python}"
    return versions if more is None else f"{versions}, {more()}"


@dataclass(frozen=True)
class _Done(Generic[T]):
    """What became of numbers on a worker; an error ends it, and does not look like an error of the cluster."""

    values: list[T]
    error: Exception | None
    seconds: float


def _do(work: Callable[[int], T], numbers: Sequence[int], versions: Versions) -> _Done[T]:
    """Return what work gives for numbers, up to its first error."""
    begun, values = time.monotonic(), list[T]()
    try:
        versions.require()
        for number in numbers:
            values.append(work(number))
    except Exception as error:
        return _Done(values, error, time.monotonic() - begun)
    return _Done(values, None, time.monotonic() - begun)
