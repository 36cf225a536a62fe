"""Who computes the jobs of a project: this process, other processes of this computer, or a Dask cluster."""

from __future__ import annotations

import os
import signal
import traceback
from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import Any, Protocol

from metrocli import tasks
from metrocli.errors import NO_MEMORY, InputError, MetrocliError
from metrocli.frozen import dataclass
from metrocli.progress import SILENT, Progress
from metrocli.project.job import JobFile, JobOptions, load
from metrocli.project.runner import HERE, compute
from metrocli.record import Record
from metrocli.result import Result
from metrocli.uncertainty.workers import Workers

_DEFECT = "this is a defect of metrocli; please report it with the lines above"


@dataclass(frozen=True)
class JobOutcome:
    """What became of a job: its result, or an error with its exit code."""

    result: Result | None = None
    record: Record | None = None
    exit_code: int = 0
    error: str = ""


class Executor(Protocol):
    """Computes jobs, several at once or one after the other."""

    places: int
    """Number of jobs that may be in work at once"""

    def begin(self, name: str, job: JobFile, strict: bool) -> None:
        """Begin to compute a job; `name` stands for it when it is finished."""

    def finished(self) -> Iterator[tuple[str, JobOutcome]]:
        """Wait until at least one job is finished, and yield the outcome of each."""


def attempt(job: JobFile, strict: bool, progress: Progress = SILENT, workers: Workers = HERE) -> JobOutcome:
    """Compute a job and return what became of it; nothing is written but finished chunks."""
    try:
        return JobOutcome(*compute(job, progress, workers, strict))
    except InputError as error:
        return JobOutcome(exit_code=error.exit_code, error=str(error))
    except MetrocliError as error:
        return JobOutcome(exit_code=error.exit_code, error=f"{job.file}: error: {error}")
    except MemoryError:
        return JobOutcome(exit_code=InputError.exit_code, error=f"{job.file}: error: {NO_MEMORY}")
    except Exception:
        return JobOutcome(exit_code=MetrocliError.exit_code, error=f"{traceback.format_exc()}\n{_DEFECT}")


class InThisProcess:
    """This process, with all its threads for one job at a time."""

    places = 1

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._done: list[tuple[str, JobOutcome]] = []

    def begin(self, name: str, job: JobFile, strict: bool) -> None:
        self._done.append((name, attempt(job, strict, self._progress)))

    def finished(self) -> Iterator[tuple[str, JobOutcome]]:
        yield from self._done
        self._done.clear()


@dataclass(frozen=True)
class _Begun:
    """A job that is in work in another process."""

    name: str
    call: tuple[Path, JobOptions, bool]
    """Arguments of `_loaded_and_attempted`"""


class Processes:
    """Processes with one thread each; a job is loaded again where it is computed.

    If a process dies, all others end with it. What they had in work is then computed again, one job after the other, so
    that a job whose process dies again is known.
    """

    def __init__(self, places: int) -> None:
        self.places = places
        self._pool = _new_pool(places)
        self._running: dict[Future[JobOutcome], _Begun] = {}

    def begin(self, name: str, job: JobFile, strict: bool) -> None:
        begun = _Begun(name, (job.file, job.options.elsewhere(), strict))
        try:
            submitted = self._pool.submit(_loaded_and_attempted, *begun.call)
        except BrokenProcessPool as error:  # a process died since the last look
            submitted = Future()
            submitted.set_exception(error)
        self._running[submitted] = begun

    def finished(self) -> Iterator[tuple[str, JobOutcome]]:
        done = wait(self._running, return_when=FIRST_COMPLETED).done
        if any(isinstance(future.exception(), BrokenProcessPool) for future in done):
            done = wait(self._running).done
        lost = []
        for future_done in done:
            begun = self._running.pop(future_done)
            if isinstance(future_done.exception(), BrokenProcessPool):
                lost.append(begun)
            else:
                yield begun.name, _outcome(future_done)
        # one process for each: a job that ends its process again is then known, and takes no other with it
        if lost:
            self.end()
            for begun in lost:
                self._pool = _new_pool(1)
                yield begun.name, _outcome(self._pool.submit(_loaded_and_attempted, *begun.call))
                self.end()
            self._pool = _new_pool(self.places)

    def kill(self) -> None:
        """End all processes at once, whatever they do."""
        for process in list((self._pool._processes or {}).values()):
            process.kill()

    def end(self) -> None:
        """Wait for the processes to end, which begin nothing more."""
        self._pool.shutdown(wait=True, cancel_futures=True)


def _outcome(future: Future[JobOutcome]) -> JobOutcome:
    try:
        return future.result()
    except BrokenProcessPool:
        text = "error: its process was ended twice, by the system (too little memory?) or by a defect"
        return JobOutcome(exit_code=MetrocliError.exit_code, error=text)
    except Exception as error:
        return JobOutcome(exit_code=MetrocliError.exit_code, error=f"error: its process ended: {error}")


@contextmanager
def processes(count: int) -> Iterator[Processes]:
    """Yield a executor of processes; they end when the block ends, however it does."""
    executor = Processes(count)
    try:
        yield executor
    except BaseException:
        executor.kill()
        raise
    finally:
        executor.end()


def _new_pool(count: int) -> ProcessPoolExecutor:
    # spawned: a fork takes over locks that other threads of the run hold, and nobody lets go of them
    return ProcessPoolExecutor(count, get_context("spawn"), _prepare, (dict(tasks.KINDS),))


def _prepare(kinds: Mapping[str, Any]) -> None:
    """Prepare a process: the kinds of job of the one that started it, and no answer to Ctrl-C of its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()
    tasks.KINDS.update(kinds)


def _end_with_parent() -> None:
    """End this process when the one that started it has ended; a killed one cannot end its processes itself."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        # not `sys.exit`, which ends a thread only
        os._exit(MetrocliError.exit_code)


def _loaded_and_attempted(file: Any, options: JobOptions, strict: bool) -> JobOutcome:
    try:
        job = load(file, options)
    except MetrocliError as error:
        return JobOutcome(exit_code=error.exit_code, error=str(error))
    return attempt(job, strict, workers=Workers(1))
