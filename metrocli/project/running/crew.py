"""Who computes the jobs of a project: this process, other processes of this computer, or a Dask cluster."""

from __future__ import annotations

import traceback
from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, Protocol

from metrocli import tasks
from metrocli.errors import InputError, MetrocliError
from metrocli.project.job import JobFile, Wishes, load
from metrocli.project.runner import HERE, Progress, compute
from metrocli.record import Record
from metrocli.result import Result
from metrocli.uncertainty.workers import Workers

_DEFECT = "this is a defect of metrocli; please report it with the lines above"


@dataclass(frozen=True)
class Outcome:
    """What became of a job: its result, or an error with its exit code."""

    result: Result | None = None
    record: Record | None = None
    exit_code: int = 0
    error: str = ""


class Crew(Protocol):
    """Computes jobs, several at once or one after the other."""

    places: int
    """Number of jobs that may be in work at once"""

    def begin(self, name: str, job: JobFile, strict: bool) -> None:
        """Begin to compute a job; `name` stands for it when it is finished."""

    def finished(self) -> Iterator[tuple[str, Outcome]]:
        """Wait until at least one job is finished, and yield the outcome of each."""


def attempt(job: JobFile, strict: bool, progress: Progress = lambda line: None, workers: Workers = HERE) -> Outcome:
    """Compute a job and return what became of it; nothing is written but finished chunks."""
    try:
        return Outcome(*compute(job, progress, workers, strict))
    except InputError as error:
        return Outcome(exit_code=error.exit_code, error=str(error))
    except MetrocliError as error:
        return Outcome(exit_code=error.exit_code, error=f"{job.file}: error: {error}")
    except Exception:
        return Outcome(exit_code=MetrocliError.exit_code, error=f"{traceback.format_exc()}\n{_DEFECT}")


class Alone:
    """This process, with all its threads for one job at a time."""

    places = 1

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._done: list[tuple[str, Outcome]] = []

    def begin(self, name: str, job: JobFile, strict: bool) -> None:
        self._done.append((name, attempt(job, strict, self._progress)))

    def finished(self) -> Iterator[tuple[str, Outcome]]:
        yield from self._done
        self._done.clear()


class Processes:
    """Processes with one thread each; a job is loaded again where it is computed."""

    def __init__(self, pool: ProcessPoolExecutor, places: int) -> None:
        self.places = places
        self._pool = pool
        self._running: dict[Future[Outcome], str] = {}

    def begin(self, name: str, job: JobFile, strict: bool) -> None:
        submitted = self._pool.submit(_loaded_and_attempted, job.file, job.wishes.elsewhere(), strict)
        self._running[submitted] = name

    def finished(self) -> Iterator[tuple[str, Outcome]]:
        for one in wait(self._running, return_when=FIRST_COMPLETED).done:
            name = self._running.pop(one)
            try:
                yield name, one.result()
            except Exception as error:
                yield name, Outcome(exit_code=MetrocliError.exit_code, error=f"error: its process ended: {error}")


@contextmanager
def processes(count: int) -> Iterator[Processes]:
    """Yield a crew of processes; they end when the block ends, however it does."""
    pool = ProcessPoolExecutor(count, get_context("spawn"), _prepare, (dict(tasks.KINDS),))
    crew = Processes(pool, count)
    try:
        yield crew
    except BaseException:
        for process in list((pool._processes or {}).values()):
            process.kill()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _prepare(kinds: Mapping[str, Any]) -> None:
    """Prepare a process: the kinds of job of the one that started it, and no answer to Ctrl-C of its own."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    tasks.KINDS.update(kinds)


def _loaded_and_attempted(file: Any, wishes: Wishes, strict: bool) -> Outcome:
    try:
        job = load(file, wishes)
    except MetrocliError as error:
        return Outcome(exit_code=error.exit_code, error=str(error))
    return attempt(job, strict, workers=Workers(1))
