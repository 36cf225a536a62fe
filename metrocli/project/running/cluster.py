"""The jobs of a project on a Dask cluster: files travel with the jobs, and results come back to be written here."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from metrocli.errors import InputError, MetrocliError
from metrocli.formats.file_bytes import read_bytes
from metrocli.frozen import dataclass
from metrocli.project.job import JobFile, JobOptions, load
from metrocli.project.own_effects import alike_for
from metrocli.project.running.executor import JobOutcome, attempt
from metrocli.uncertainty.workers import Workers
from metrocli.uncertainty.workers.dask_cluster import Versions, cluster, ends_in_words, first_finished

_MOST_AT_ONCE = 25
"""Most jobs in one task of the cluster, so that its overhead of some milliseconds does not count"""
_TASKS_PER_THREAD = 2


@dataclass(frozen=True)
class Packed:
    """A job with the files that it names, by their paths below the folder that holds them all."""

    name: str
    shown: str
    """That folder as messages name it, with a slash at its end; empty for the working folder"""
    file: str
    options: JobOptions
    strict: bool
    files: Mapping[str, bytes]


def pack(name: str, job: JobFile, strict: bool) -> Packed:
    """Return a job ready to travel; raises InputError if a file cannot be read."""
    options = job.options.elsewhere()
    job = replace(job, options=options)
    paths = {Path(os.path.abspath(path)) for path in (*job.stated_in, *job.files)}
    file = Path(os.path.abspath(job.file))
    root = os.path.commonpath([os.path.abspath(job.output.parent), *(path.parent for path in paths)])
    files = {os.path.relpath(path, root): read_bytes(path).data for path in paths}
    shown = "" if os.path.samefile(root, ".") else os.path.relpath(root) + os.sep
    return Packed(name, shown, os.path.relpath(file, root), options, strict, files)


def carry_out(jobs: Sequence[Packed], versions: Versions) -> list[tuple[str, JobOutcome]]:
    """Compute jobs on a worker, in a folder of their own, and return what became of them.

    Raises InputError if the worker has other versions than the process that asks.
    """
    versions.require()
    return [(job.name, _carry_out(job)) for job in jobs]


def _carry_out(packed: Packed) -> JobOutcome:
    with tempfile.TemporaryDirectory(prefix="metrocli-") as folder:
        for name, data in packed.files.items():
            path = Path(folder) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        try:
            outcome = attempt(
                load(Path(folder) / packed.file, packed.options), packed.strict, workers=Workers(1, helped=True)
            )
        except MetrocliError as error:
            outcome = JobOutcome(exit_code=error.exit_code, error=str(error))
        return replace(outcome, error=outcome.error.replace(folder + os.sep, packed.shown))


class DaskExecutor:
    """A executor of the workers of a Dask cluster."""

    def __init__(self, client: Any, address: str, versions: Versions) -> None:
        self._client, self._address, self._versions = client, address, versions
        self._threads = max(sum(client.nthreads().values()), 1)
        self.places = self._threads * _TASKS_PER_THREAD * _MOST_AT_ONCE
        self._packed: list[Packed] = []
        self._done: list[tuple[str, JobOutcome]] = []
        self._running: set[Any] = set()

    def begin(self, name: str, job: JobFile, strict: bool) -> None:
        try:
            self._packed.append(pack(name, job, strict))
        except InputError as error:
            self._done.append((name, JobOutcome(exit_code=error.exit_code, error=str(error))))

    def finished(self) -> Iterator[tuple[str, JobOutcome]]:
        size = min(max(-(-len(self._packed) // (_TASKS_PER_THREAD * self._threads)), 1), _MOST_AT_ONCE)
        batches = [self._packed[at : at + size] for at in range(0, len(self._packed), size)]
        self._packed = []
        with ends_in_words(self._address, "finished results are kept, "):
            # not pure: Dask would give a job that is submitted again the result of before
            self._running |= {self._client.submit(carry_out, batch, self._versions, pure=False) for batch in batches}
            if not self._done:
                self._take(first_finished(self._client, self._running))
        yield from self._done
        self._done = []

    def _take(self, futures: set[Any]) -> None:
        for future in futures:
            self._running.discard(future)
            self._done += future.result()


@contextmanager
def on_cluster(address: str, jobs: Iterable[JobFile]) -> Iterator[DaskExecutor]:
    """Yield the executor of a running cluster for some jobs.

    Raises InputError if it cannot be used, or has another metrocli or other packages with effects of these jobs.
    """
    more = alike_for((job.kind, job.effects_of_packages) for job in jobs)
    with cluster(address, more) as client:
        yield DaskExecutor(client, address, Versions.here(more))
