"""One job from file to result: read the inputs, run the task, check the criteria, write the result."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from metrocli import __version__, tasks
from metrocli.doubt import doubts_of
from metrocli.effects.wanted import planted
from metrocli.errors import Fault, InputError, MetrocliError, UsageError
from metrocli.plan import Plan
from metrocli.project.chunks import ChunkFolder
from metrocli.project.inputs import input_files, read_inputs, unfit_inputs
from metrocli.project.job import JobFile
from metrocli.record import Record, Verdict
from metrocli.result import Result
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import Table
from metrocli.tasks.job import Job
from metrocli.uncertainty.workers import Workers

HERE = Workers()
"""Threads on all cores of this computer"""
Progress = Callable[[str], None]
"""Receives a line of progress."""


@dataclass(frozen=True)
class Done:
    """A job that has run and whose result is written."""

    result: Result
    record: Record
    path: Path


def carry_out(
    file: JobFile,
    force: bool = False,
    progress: Progress = lambda line: None,
    workers: Workers = HERE,
    strict: bool = False,
) -> Done:
    """Read the inputs, run the task, check the acceptance criteria and write the result; write nothing on any error.

    With `strict` every warning makes the result doubtful.

    The chunks that `workers` finish are kept beside the output until the job is done: a killed run then continues.
    """
    kind = tasks.KINDS[file.kind]
    refuse_foreign(file.output, file.kind, force)
    files = input_files(file)
    progress(f"{file.file}: reading {len(files)} input files")
    job = content(file)
    progress(f"{file.file}: {file.kind}")
    if kind.chunked:
        job = replace(job, workers=replace(workers, finished=ChunkFolder(file.output.with_suffix(".chunks"))))
    result = _sound(file, job)
    result = replace(
        result,
        title=result.title or file.heading.title,
        warnings=(*_accepted(file), *_table_warnings(job.files), *result.warnings),
    )
    created = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    verdicts = _verdicts(file, result)
    record = Record(file.text, files, __version__, created, verdicts, doubts_of(result, verdicts, strict))
    from metrocli.formats import hdf5

    hdf5.write(file.output, result, record)
    return Done(result, record, file.output)


def _sound(file: JobFile, job: Job[Any, Any]) -> Result:
    """Return the result of a job; raise InputError if a file fits far better when it is read in another way."""
    from metrocli.diagnosis.mistakes import misread, suspicious

    task = tasks.KINDS[file.kind].task()
    failure: MetrocliError | None = None
    try:
        result = task.run(job)
        sigma0 = result.statistics.get("sigma0", 0.0)
        if task.diagnosed is None or not isinstance(sigma0, float) or not suspicious(sigma0, result.astray):
            return result
    except MetrocliError as error:
        if task.diagnosed is None:
            raise
        failure = error
    adjusted = task.diagnosed
    refusal = misread(vars(job.files), lambda inputs: adjusted(replace(job, files=task.files(**inputs))), failure)
    if refusal is not None:
        raise refusal from failure
    if failure is not None:
        raise failure
    return result


def content(file: JobFile, absent: Collection[str] = ()) -> Job[Any, Any]:
    """Return a job with the content of its files; inputs in `absent` may be missing."""
    held = read_inputs(file, absent)
    return tasks.KINDS[file.kind].task().job(file.settings, effects=file.effects, **held)


def verify(file: JobFile, job: Job[Any, Any]) -> None:
    """Raise InputError if settings and inputs of a job do not fit together; nothing is computed."""
    check = tasks.KINDS[file.kind].task().check
    if check is not None:
        check(job)


def answer(file: JobFile, question: str) -> Table:
    """Return the answer to a question (`compare`, ...) about a job; nothing is written."""
    return tasks.KINDS[file.kind].task().answers[question](content(file))


def simulate(file: JobFile, options: SimulationOptions) -> Simulation:
    """Return the measurement that the model of a job predicts."""
    kind = tasks.KINDS[file.kind]
    simulated = kind.task().simulate
    if simulated is None:
        raise UsageError(f"{file.kind} jobs cannot be simulated")
    return simulated(content(replace(file, effects=planted(file.effects)), kind.measured), options)


def plan(file: JobFile) -> Plan:
    """Return the plan of the measurement that a job describes."""
    kind = tasks.KINDS[file.kind]
    planned = kind.task().plan
    if planned is None:
        raise UsageError(f"{file.kind} jobs cannot be planned")
    return planned(content(file, kind.planned))


def refuse_foreign(path: Path, kind: str, force: bool) -> None:
    """Raise InputError if `path` holds something other than a result of this kind, unless forced."""
    if path.is_dir():
        raise InputError([Fault("the output is a folder", str(path), hint="name a file that ends in .h5")])
    if force or not path.exists():
        return
    from metrocli.formats import hdf5

    there = hdf5.kind_of(path)
    if there in (kind, ""):
        return
    what = "is not a result of metrocli" if there is None else f"is a result of {there}"
    raise InputError([Fault(f"the file exists and {what}", str(path), hint="choose another --output, or use --force")])


def _accepted(file: JobFile) -> tuple[str, ...]:
    """Return a warning for each input that is used though it is not fit for use."""
    return tuple(f"{fault.message}; accepted by --accept-doubtful" for fault in unfit_inputs(file))


def _table_warnings(files: Any) -> tuple[str, ...]:
    """Return the warnings of the readers of the tables."""
    held = (getattr(files, field.name) for field in fields(files))
    return tuple(line for value in held if isinstance(value, Table) for line in value.warnings)


def _verdicts(file: JobFile, result: Result) -> tuple[Verdict, ...]:
    faults: list[Fault] = []
    verdicts = [requirement.verdict(result, faults) for requirement in file.heading.require]
    if faults:
        raise InputError(faults)
    return tuple(verdict for verdict in verdicts if verdict is not None)
