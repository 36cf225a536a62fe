"""One job from file to result: read the inputs, run the task, check the criteria, write the result."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import fields, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrocli import __version__, tasks
from metrocli.arrays import keep_memory
from metrocli.doubt import doubts_of
from metrocli.effects.requested import planted
from metrocli.errors import Fault, InputError, MetrocliError, NotConvergedError, UndeterminedError, UsageError
from metrocli.formats import hdf5
from metrocli.formats.file_bytes import refuse_unwritable
from metrocli.formats.hdf5 import refuse_foreign
from metrocli.formats.images import DecodedImages
from metrocli.frozen import dataclass
from metrocli.plan import Plan
from metrocli.progress import SILENT, Named, Progress
from metrocli.project import fingerprint
from metrocli.project.inputs import placed, read_inputs, read_with_files, unfit_inputs
from metrocli.project.job import JobFile
from metrocli.project.named_files import absolute
from metrocli.project.requirements import by_names, decisions, figures_of
from metrocli.project.running.files import ChunkFolder
from metrocli.record import CriterionVerdict, Record
from metrocli.result import Result
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import Table
from metrocli.tasks.job import Job
from metrocli.uncertainty.workers import Workers

if TYPE_CHECKING:
    from metrocli.diagnosis.trials import Others
    from metrocli.tasks.job import Adjustment

HERE = Workers()
"""Threads on all cores of this computer"""


@dataclass(frozen=True)
class Done:
    """A job that has run and whose result is written."""

    result: Result
    record: Record
    path: Path


def carry_out(
    file: JobFile,
    force: bool = False,
    progress: Progress = SILENT,
    workers: Workers = HERE,
    strict: bool = False,
) -> Done:
    """Read the inputs, run the task, check the acceptance criteria and write the result; write nothing on any error.

    With `strict` every warning makes the result doubtful.

    The chunks that `workers` finish are kept beside the output until the job is done: a killed run then continues.
    """
    refuse_unwritable(file.output)
    if not force:
        refuse_foreign(file.output, file.kind)
    return write(file, *compute(file, progress, workers, strict))


def write(file: JobFile, result: Result, record: Record) -> Done:
    """Write the result of a job and return what was done."""
    hdf5.write(file.output, result, record)
    return Done(result, record, file.output)


def compute(
    file: JobFile, progress: Progress = SILENT, workers: Workers = HERE, strict: bool = False
) -> tuple[Result, Record]:
    """Read the inputs, run the task and check the acceptance criteria; write nothing but finished chunks.

    With `strict` every warning makes the result doubtful.
    """
    keep_memory()
    kind = tasks.KINDS[file.kind]
    progress = Named(file.file, progress)
    progress.doing("reading its inputs")
    held, files = read_with_files(file)
    held = counting(held, progress)
    _require_named(file, held)
    job = _job(file, held)
    progress.doing(file.kind)
    if kind.chunked:
        finished = ChunkFolder(file.output.with_suffix(".chunks"))
        job = replace(job, workers=replace(workers, finished=finished, tell=progress.count))
    result = _sound(file, job, progress)
    result = replace(
        result,
        title=result.title or file.heading.title,
        warnings=_by_name(file, (*_accepted(file), *_table_warnings(job.files), *result.warnings)),
    )
    created = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    verdicts = _verdicts(file, result)
    doubts = doubts_of(result, verdicts, strict)
    place = Path(os.path.relpath(file.file, file.output.parent)).as_posix()
    certificate = file.heading.certificate.stated() if file.heading.certificate is not None else {}
    record = Record(
        file.text, files, __version__, created, verdicts, doubts, fingerprint.of_job(file), job_file=place,
        certificate=certificate,
    )  # fmt: skip
    return result, replace(record, content=fingerprint.of_result(result, record))


def counting(held: Mapping[str, Any], progress: Progress) -> dict[str, Any]:
    """Return inputs of which those that are read bit by bit, such as images, count what is read."""
    return {
        key: replace(counts, tell=progress.count) if isinstance(counts, DecodedImages) else counts
        for key, counts in held.items()
    }


@placed
def _sound(file: JobFile, job: Job[Any, Any], progress: Progress) -> Result:
    """Return the result of a job; raise InputError if a file fits far better when it is read in another way."""
    from metrocli.diagnosis.mistakes import misread, suspicious

    task = tasks.KINDS[file.kind].task()
    failure: MetrocliError | None = None
    try:
        result, adjustment = task.carried_out(job)
        sigma0 = result.statistics.get("sigma0", 0.0)
        if task.diagnosed is None or not isinstance(sigma0, float):
            return result
        # a sound job pays nothing for the other readings of its files (docs/decisions/058)
        if not suspicious(sigma0, result.list_offset):
            rejected = result.statistics.get("rejected", 0)
            left_out = rejected if isinstance(rejected, int) else 0
            return _with_other_setting(result, adjustment, partial(task.others, job), sigma0, left_out)
        placed = result if suspicious(sigma0, 0.0) else _elsewhere(result)
    except MetrocliError as error:
        if task.diagnosed is None:
            raise
        failure = error
    adjusted = task.diagnosed
    progress.doing("its readings do not fit: trying its files with other units and axes")
    refusal = misread(
        vars(job.files),
        lambda inputs: adjusted(replace(job, files=task.files(**inputs))),
        failure,
        partial(task.others, job),
        task.unplaced,
    )
    if refusal is not None:
        raise refusal from failure
    if failure is not None:
        raise failure
    return _with_other_setting(placed, adjustment, partial(task.others, job), float("inf"))


def _elsewhere(result: Result) -> Result:
    """Return a result, whose readings fit one another, that is doubtful where its places are not those of its lists."""
    if result.list_offset <= 1:
        return result
    doubt = (
        f"its places lie {result.list_offset:.1f} times as far from those that its files list as is plausible: a list "
        "is wrong, such as rows in another order, and no other unit or axis mends it"
    )
    return replace(result, doubts=(*result.doubts, doubt))


def _with_other_setting(
    result: Result, adjustment: Adjustment | None, others: Others, sigma0: float, left_out: int = 0
) -> Result:
    """Return a result that is doubtful where the readings fit far better with another setting of its job."""
    from metrocli.diagnosis.other_settings import with_other_setting

    if adjustment is None or not others(sigma0, left_out):
        return result
    mistaken = with_other_setting(adjustment(), others)
    if mistaken is None:
        return result
    (wrong,) = mistaken.mistakes
    doubt = f"{wrong}: with this corrected, {mistaken.gain}; write {wrong.write}"
    return replace(result, doubts=(*result.doubts, doubt))


def content(file: JobFile, absent: Collection[str] = ()) -> Job[Any, Any]:
    """Return a job with the content of its files; inputs in `absent` may be missing."""
    return _job(file, read_inputs(file, absent))


def _job(file: JobFile, held: Mapping[str, Any]) -> Job[Any, Any]:
    return tasks.KINDS[file.kind].task().job(file.settings, effects=file.effects, **held)


@placed
def verify(file: JobFile, renewed: Collection[Path] = ()) -> None:
    """Raise InputError for faults of a job's inputs, and if settings and inputs do not fit together.

    Nothing is adjusted, and what only the adjustment can judge is left to it, such as whether the data determine the
    unknowns. While results that other jobs will write are missing, or are `renewed` by jobs that would run before, the
    other inputs are read only.
    """
    missing = [
        item.key
        for item in file.inputs
        if not all(path.exists() for path in item.paths) or any(absolute(path) in renewed for path in item.paths)
    ]
    held = read_inputs(file, missing)
    if not missing:
        _require_named(file, held)
    check = tasks.KINDS[file.kind].task().check
    if check is not None and not missing:
        with suppress(UndeterminedError, NotConvergedError):
            check(_job(file, held))


def _require_named(file: JobFile, held: Mapping[str, Any]) -> None:
    """Raise InputError for each criterion that names what no table has, such as a tracer."""
    faults: list[Fault] = []
    known = known_figures(file, held) if file.heading.require else {}
    for requirement in file.heading.require:
        requirement.limit_among(known, faults)
    if faults:
        raise InputError(faults)


def known_figures(file: JobFile, held: Mapping[str, Any]) -> dict[str, str]:
    """Return the units of all figures that a result can have, by name, as far as its settings and tables name them."""
    names: dict[str, set[str]] = {}
    for table in (counts for counts in held.values() if isinstance(counts, Table)):
        for column in (name for name, cells in table.columns.items() if cells.dtype.kind == "U"):
            names.setdefault(column, set()).update(table.texts(column))
    return by_names(figures_of(file.kind, file.settings, file.effects), names)


@placed
def answer(file: JobFile, question: str) -> Table:
    """Return the answer to a question (`compare`, ...) about a job; nothing is written."""
    return tasks.KINDS[file.kind].task().answers[question](content(file))


@placed
def simulate(file: JobFile, options: SimulationOptions) -> Simulation:
    """Return the measurement that the model of a job predicts."""
    kind = tasks.KINDS[file.kind]
    simulated = kind.task().simulate
    if simulated is None:
        raise UsageError(f"{file.kind} jobs cannot be simulated")
    return simulated(content(replace(file, effects=planted(file.effects)), kind.measured), options)


@placed
def plan(file: JobFile) -> Plan:
    """Return the plan of the measurement that a job describes."""
    kind = tasks.KINDS[file.kind]
    planned = kind.task().plan
    if planned is None:
        raise UsageError(f"{file.kind} jobs cannot be planned")
    return planned(content(file, kind.planned))


def _by_name(file: JobFile, lines: Iterable[str]) -> tuple[str, ...]:
    """Return lines that name the inputs relative to the job file, so that they are the same from every folder."""
    names = {str(path): os.path.relpath(path, file.folder) for item in file.inputs for path in item.paths}
    for path, name in names.items():
        lines = [line.replace(path, name) for line in lines]
    return tuple(lines)


def _accepted(file: JobFile) -> tuple[str, ...]:
    """Return a warning for each input that is used though it is not fit for use."""
    return tuple(f"{fault.message}; accepted by --accept-doubtful" for fault in unfit_inputs(file))


def _table_warnings(files: Any) -> tuple[str, ...]:
    """Return the warnings of the readers of the tables."""
    held = (getattr(files, field.name) for field in fields(files))
    return tuple(line for value in held if isinstance(value, Table) for line in value.warnings)


def _verdicts(file: JobFile, result: Result) -> tuple[CriterionVerdict, ...]:
    faults: list[Fault] = []
    verdicts = [requirement.verdict(result, faults) for requirement in file.heading.require]
    if faults:
        raise InputError(faults)
    decided = [verdict for verdict in verdicts if verdict is not None]
    return (*decided, *decisions(result, file.heading.conformity == "report"))
