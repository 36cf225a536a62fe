"""A Dask cluster that runs already: is it there, is it the same metrocli, and what it makes of numbers, in order.

Method: docs/algorithms/monte-carlo-chunks.md.
"""

from __future__ import annotations

import json
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from typing import Any, Generic, TypeVar

from metrocli import __version__
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass

T = TypeVar("T")
PATIENCE_S = 2.5
"""Longest time for a scheduler to answer [s]"""
PATIENCE_WITH_WORKERS_S = 60.0
"""Longest time until the first worker of a cluster appears [s]"""
_LONGEST_HELLO = 1 << 20
"""Bytes that the handshake of a scheduler has at most"""
_TASK_S, _MOST_AT_ONCE = 1.0, 25
"""Time that a task of a cluster should take [s], so that sending it does not count, and the most numbers in one"""
_ADDRESSES, _ENCRYPTED = ("tcp://", "tls://", "ucx://", "ws://", "wss://"), ("tls://", "wss://")


@contextmanager
def cluster(address: str, more: Callable[[], str] | None = None) -> Iterator[Any]:
    """Yield a client of a Dask cluster that has workers; raises InputError without them or if their versions differ.

    `more` states in words what else must be the same there as here.
    """
    client = _client(address)
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
            found: _Done[T] = future.result()
        return found

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
    others = {str(one) for one in answers if not isinstance(one, OSError)} - {here}
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
    found = f"metrocli {__version__} with numpy {np.__version__} and Python {python}"
    return found if more is None else f"{found}, {more()}"


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


def _must_listen(address: str) -> None:
    """Raise InputError if nothing listens at tcp://HOST:PORT; checked before the slow import of the library."""
    import socket
    from urllib.parse import urlsplit

    try:
        place = urlsplit(address)
        with socket.create_connection((place.hostname, place.port or 8786), PATIENCE_S) as found:
            found.settimeout(PATIENCE_S)
            # a scheduler speaks first: the length of its handshake as 8 bytes, which is small; with TLS it waits
            head = found.recv(8, socket.MSG_WAITALL) if place.scheme == "tcp" else b""
    except TimeoutError as error:
        raise _unanswered(address, TimeoutError("it accepts the connection and says nothing")) from error
    except (OSError, ValueError) as error:
        raise _unanswered(address, error) from error
    if place.scheme == "tcp" and not 0 < int.from_bytes(head, "little") < _LONGEST_HELLO:
        said = head.split(b"\r")[0].decode("ascii", "replace")
        raise _unanswered(address, ValueError(f"what answers begins with '{said}'" if head else "it hangs up"))


def _unanswered(address: str, error: Exception) -> InputError:
    hint = "one with TLS has an address tls://HOST:PORT" if address.startswith("tcp://") else None
    return InputError([Fault(f"--scheduler {address}: no Dask scheduler answers there ({error})", hint=hint)])


def _in_file(path: str) -> str:
    """Return the address that a scheduler file holds."""
    if not os.path.isfile(path):
        raise InputError(f"--scheduler {path}: no such scheduler file; write tcp://HOST:PORT or the path of one")
    try:
        with open(path, encoding="utf-8") as file:
            return str(json.load(file)["address"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"--scheduler {path}: this is no scheduler file of Dask ({error})") from error


def _silence() -> None:
    """Keep from the terminal what the library writes for those who program with it.

    That is its tracebacks when a cluster is lost, which errors state in words, and its advice on large files.
    """
    import logging
    import warnings

    warnings.filterwarnings("ignore", "Sending large graph", UserWarning)

    # its configuration gives some of its loggers levels of their own
    for name in ("distributed", *logging.root.manager.loggerDict):
        if name.partition(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL)


def _security(library: Any, address: str) -> Any:
    """Return the security of Dask's own configuration; raise InputError if it lacks what an encrypted address needs."""
    security = library.Security()
    hint = "state ca-file, client.cert and client.key under distributed.comm.tls in the configuration of Dask"
    try:
        context = security.get_connection_args("client").get("ssl_context")
    except OSError as error:
        files = ", ".join(filter(None, (security.tls_ca_file, security.tls_client_cert, security.tls_client_key)))
        message = f"--scheduler {address}: the certificates {files} cannot be used ({error})"
        raise InputError([Fault(message, hint=hint)]) from error
    if address.startswith(_ENCRYPTED) and context is None:
        raise InputError(
            [Fault(f"--scheduler {address}: the scheduler uses TLS, and no certificate is given", hint=hint)]
        )
    return security


def _client(scheduler: str) -> Any:
    """Return a client of a running cluster, or raise InputError in a few seconds."""
    address = scheduler if scheduler.startswith(_ADDRESSES) else _in_file(scheduler)
    if address.startswith(("tcp://", "tls://")):
        _must_listen(address)
    try:
        import distributed
    except ImportError as error:
        raise InputError("--scheduler needs the library 'distributed': pip install 'metrocli[cluster]'") from error
    library: Any = distributed
    _silence()
    security = _security(library, address)
    return _in_time(address, lambda: library.Client(address, timeout=PATIENCE_S, security=security))


def _in_time(address: str, connect: Callable[[], T]) -> T:
    """Return what a connection returns, or raise InputError after 2 PATIENCE_S: the library may wait without end."""
    import threading

    found, failed = list[T](), list[Exception]()

    def work() -> None:
        try:
            found.append(connect())
        except Exception as error:
            failed.append(error)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(2 * PATIENCE_S)
    if found:
        return found[0]
    if failed and not isinstance(failed[0], OSError | TimeoutError | ValueError):
        raise failed[0]
    error = failed[0] if failed else TimeoutError(f"the handshake has not ended after {2 * PATIENCE_S:g} s")
    raise _unanswered(address, error) from error
