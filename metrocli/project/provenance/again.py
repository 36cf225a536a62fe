"""A result made again from the job and the inputs that it names."""

from __future__ import annotations

import os
from pathlib import Path

from metrocli.errors import Fault, InputError
from metrocli.formats import hdf5
from metrocli.progress import SILENT, Progress
from metrocli.project import meaning
from metrocli.project.inputs import content_now, input_files
from metrocli.project.job import JobFile, Wishes, load
from metrocli.project.runner import HERE, compute
from metrocli.record import Record
from metrocli.result import Result
from metrocli.uncertainty.workers import Workers


def rerun(
    path: Path, accept_doubtful: bool = False, progress: Progress = SILENT, workers: Workers = HERE
) -> tuple[Result, Record, bool]:
    """Return the result of a file made again with its record, and whether it is the same bit for bit.

    The job is the text in the result, not its file. Raises InputError with each input that is not what it was.
    """
    result, record = hdf5.read(path)
    job = _job_of(path, record, accept_doubtful)
    changed = meaning.changed_inputs(record.inputs, input_files(job), lambda name: content_now(job, name))
    if changed:
        hint = "restore it from where the record has its sha256 (metrocli lineage), or run the job as it is now"
        raise InputError([Fault(line, str(path), hint=hint) for line in changed])
    strict = bool(result.warnings) and set(result.warnings) <= set(record.doubts)
    again, new = compute(job, progress, workers, strict)
    return again, new, new.content == record.content


def _job_of(path: Path, record: Record, accept_doubtful: bool) -> JobFile:
    if not record.job_file:
        raise InputError([Fault("the result does not name its job file", str(path))])
    file = Path(os.path.normpath(path.parent / record.job_file))
    return load(file, Wishes(output=path, accept_doubtful=accept_doubtful, text=record.job_text))
