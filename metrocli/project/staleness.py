"""Which results are out of date and why; judged by what jobs and files mean, never by time."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from metrocli import __version__
from metrocli.errors import Fault, InputError
from metrocli.formats import hdf5
from metrocli.formats.seal import Label
from metrocli.frozen import dataclass
from metrocli.project import fingerprint, yaml_text
from metrocli.project.inputs import content_now, input_files
from metrocli.project.job import JobFile
from metrocli.project.named_files import absolute
from metrocli.project.steps import ProjectStep
from metrocli.record import DOUBTFUL, USABLE, Record


@dataclass(frozen=True)
class Staleness:
    """Whether the result of a step is up to date; `reason` states why not and is empty if it is."""

    step: ProjectStep
    reason: str
    label: Label | None = None
    """Of the result, if there is one that can be believed"""
    waits: bool = False
    """Whether the step cannot run: a result that it uses is not fit for use, or its output is not its own result"""
    depends: bool = False
    """Whether the step runs only if a job that runs before gives another result; `reason` names that job"""

    @property
    def record(self) -> Record | None:
        """The record of the result."""
        return hdf5.read_record(self.step.job.output)[1] if self.label is not None else None


def states(steps: Iterable[ProjectStep], force: bool = False, strict: bool = False) -> Iterator[Staleness]:
    """Yield for each step whether it would run and why, before anything runs."""
    steps = tuple(steps)
    if not force:
        refuse_lost(steps)
    running: dict[str, Path] = {}
    unfit: dict[str, str] = {}
    for step in steps:
        cause = next((unfit[name] for name in step.needs if name in unfit), None)
        state = Staleness(step, cause, waits=True) if cause else state_of(step, running, force, strict)
        if state.waits:
            unfit[step.name] = f"{step.name} does not run"
        elif state.reason:
            running[step.name] = step.job.output
        elif state.label is not None and state.label.status not in USABLE and not step.job.accept_doubtful:
            unfit[step.name] = f"{step.name}: {unfit_words(state.label.status)}"
        yield state


def state_of(step: ProjectStep, running: dict[str, Path], force: bool = False, strict: bool = False) -> Staleness:
    """Return whether a step would run, given the outputs of jobs that run before it and have not yet run."""
    job = step.job
    before = [name for name in step.needs if name in running]
    if not os.path.lexists(job.output):
        return Staleness(step, "there is no result yet")
    label, damage = _label(job)
    if not force and (label is None or label.kind != job.kind):
        try:
            hdf5.refuse_foreign(job.output, job.kind)
        except InputError as error:
            return Staleness(step, str(error), waits=True)
    if label is None:
        return Staleness(step, damage)
    if force:
        return Staleness(step, "forced", label)
    reason = _difference(job, label, {absolute(running[name]) for name in before})
    if not reason and strict and label.warned:
        reason = "--strict, and the result has warnings"
    if not reason and before:
        return Staleness(step, f"{before[0]} runs", label, depends=True)
    return Staleness(step, reason, label)


def _label(job: JobFile) -> tuple[Label | None, str]:
    """Return the label of the result of a job, or None and why it cannot be believed."""
    try:
        return hdf5.read_label(job.output), ""
    except InputError as error:
        return None, error.faults[0].message


def _difference(job: JobFile, label: Label, running: Collection[Path]) -> str:
    """Return what changed since the result was made; empty if nothing did. Outputs of `running` jobs do not count."""
    if not fingerprint.same_version(label.metrocli_version):
        return f"the result was made by metrocli {label.metrocli_version}; this is metrocli {__version__}"
    if label.meaning != fingerprint.of_job(job):
        changed = _changed_settings(job) or [_unseen(job)]
    else:
        known = [file for file in label.inputs if absolute(job.folder / file.path) not in running]
        files = [file for file in input_files(job) if absolute(job.folder / file.path) not in running]
        changed = fingerprint.changed_inputs(known, files, lambda path: content_now(job, path))
    return f"{changed[0]}{f' (and {len(changed) - 1} more)' if len(changed) > 1 else ''}" if changed else ""


def _changed_settings(job: JobFile) -> list[str]:
    _, record = hdf5.read_record(job.output)
    before = yaml_text.parse(record.job_text, "the job of the result", job.folder)
    return fingerprint.changed_settings(before, yaml_text.parse(job.text, str(job.file), job.folder))


def _unseen(job: JobFile) -> str:
    """Return what changed where the text of a job states all values as before."""
    names = [package.name for package in job.packages]
    return f"the package {names[0]}, whose effects the job uses, changed" if names else "the job file changed"


def refuse_lost(steps: Sequence[ProjectStep]) -> None:
    """Raise InputError for each input of the last result that no longer exists, such as one image of a file pattern.

    Without this, a job would silently run with fewer images.
    """
    faults = []
    made = {absolute(step.job.output) for step in steps}
    for step in steps:
        # a job as it was meant has inputs if it had some
        label = _label(step.job)[0] if step.job.inputs or step.job.own.files else None
        if label is None:
            continue
        paths = [file.path for file in label.inputs if absolute(step.job.folder / file.path) not in made]
        lost = [path for path in paths if not (step.job.folder / path).is_file()]
        if lost and label.meaning != fingerprint.of_job(step.job):
            lost = [path for path in lost if _still_named(step.job, path)]
        hint = "restore it, or run without it by --force"
        faults += [
            Fault(f"the input {path} of the last result is gone", str(step.job.file), hint=hint) for path in lost
        ]
    if faults:
        raise InputError(faults)


def _still_named(job: JobFile, path: str) -> bool:
    """Return whether a pattern of a job would match a file, given from the folder of the job."""
    patterns = (pattern for item in job.inputs for pattern in item.patterns)
    places = (
        (os.path.abspath(job.folder / path) if pattern.is_absolute() else path, str(pattern)) for pattern in patterns
    )
    return any(_matches(Path(place).parts, Path(pattern).parts) for place, pattern in places)


def _matches(place: Sequence[str], pattern: Sequence[str]) -> bool:
    """Return whether folders and file are those of a pattern; `**` stands for any number of folders."""
    if not pattern:
        return not place
    if pattern[0] == "**":
        return any(_matches(place[skipped:], pattern[1:]) for skipped in range(len(place) + 1))
    return bool(place) and fnmatchcase(place[0], pattern[0]) and _matches(place[1:], pattern[1:])


def unfit_words(status: str) -> str:
    """Return why a result of this status is not used, and the option that uses it."""
    what = "its result is doubtful" if status == DOUBTFUL else "an acceptance criterion is not met"
    return f"{what}; --accept-doubtful uses it"
