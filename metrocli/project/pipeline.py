"""A run of a project: which results are out of date and why; judged by content, never by time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from metrocli import __version__
from metrocli.errors import Fault, InputError, MetrocliError
from metrocli.project.inputs import input_files
from metrocli.project.job import JobFile
from metrocli.project.runner import Done, Progress, carry_out
from metrocli.project.steps import Step, absolute
from metrocli.record import DONE, DOUBTFUL, Record


@dataclass(frozen=True)
class State:
    """Whether the result of a step is up to date; `reason` states why not and is empty if it is."""

    step: Step
    reason: str
    record: Record | None = None
    waits: bool = False
    """Whether the step does not run, since a result that it uses is not fit for use; `reason` names it"""


class Action(StrEnum):
    """What `run` did with a job."""

    UP_TO_DATE = "up to date"
    RAN = "ran"
    FAILED = "failed"
    NOT_RUN = "not run"


@dataclass(frozen=True)
class Report:
    """What `run` did with a step, and why."""

    step: Step
    action: Action
    reason: str
    exit_code: int = 0
    done: Done | None = None
    error: str = ""
    record: Record | None = None
    """Of the result, if there is one"""


def states(steps: Iterable[Step]) -> Iterator[State]:
    """Yield for each step whether it would run and why; a step also runs if a job runs whose result it uses."""
    steps = tuple(steps)
    _refuse_lost(steps)
    would_run: set[str] = set()
    unfit: dict[str, str] = {}
    for step in steps:
        cause = next((unfit[name] for name in step.needs if name in unfit), None)
        state = State(step, cause, waits=True) if cause else _state(step, would_run)
        if state.waits:
            unfit[step.name] = f"{step.name} does not run"
        elif state.reason:
            would_run.add(step.name)
        elif state.record is not None and state.record.status != DONE and not step.job.accept_doubtful:
            unfit[step.name] = f"{step.name}: {_unfit_words(state.record)}"
        yield state


def _refuse_lost(steps: Sequence[Step]) -> None:
    """Raise InputError for each input of the last result that no longer exists, such as one image of a file pattern.

    Without this, a job would silently run with fewer images.
    """
    from metrocli.formats import hdf5

    faults = []
    made = {absolute(step.job.output) for step in steps}
    for step in steps:
        try:
            _, record = hdf5.read_record(step.job.output) if step.job.output.exists() else ("", None)
        except InputError:
            continue
        if record is not None and record.job_text == step.job.text:
            paths = [item.path for item in record.inputs if absolute(step.job.folder / item.path) not in made]
            lost = [path for path in paths if not (step.job.folder / path).is_file()]
            hint = "restore it, or run without it by --force"
            faults += [
                Fault(f"the input {path} of the last result is gone", str(step.job.file), hint=hint) for path in lost
            ]
    if faults:
        raise InputError(faults)


def _state(step: Step, would_run: set[str]) -> State:
    from metrocli.formats import hdf5

    upstream = next((name for name in step.needs if name in would_run), None)
    if upstream is not None:
        return State(step, f"{upstream} runs")
    if not step.job.output.exists():
        return State(step, "there is no result yet")
    try:
        kind, record = hdf5.read_record(step.job.output)
    except InputError as error:
        return State(step, error.faults[0].message)
    if kind != step.job.kind:
        return State(step, f"{step.job.output} is a result of {kind}")
    return State(step, _difference(step.job, record), record)


def _difference(job: JobFile, record: Record) -> str:
    """Return what changed since the result was made; empty if nothing did."""
    if record.metrocli_version != __version__:
        return f"the result was made by metrocli {record.metrocli_version}; this is metrocli {__version__}"
    if record.job_text != job.text:
        return "the job file changed"
    before = {item.path: item.sha256 for item in record.inputs}
    now = {item.path: item.sha256 for item in input_files(job)}
    changed = [f"{path} changed" for path in now if path in before and now[path] != before[path]]
    changed += [f"{path} is new" for path in now if path not in before]
    changed += [f"{path} is gone" for path in before if path not in now]
    return f"input {changed[0]}{f' (and {len(changed) - 1} more)' if len(changed) > 1 else ''}" if changed else ""


def run(
    steps: Sequence[Step],
    force: bool,
    progress: Progress,
    finished: Callable[[Report], Any],
    strict: bool = False,
) -> list[Report]:
    """Bring every result up to date; call `finished` with the report of each job.

    After a failure, or a result that is not fit for use, jobs that need it do not run; all others do.
    """
    if not force:
        _refuse_lost(steps)
    reports: dict[str, Report] = {}
    ran: set[str] = set()
    for step in steps:
        report = _run_step(step, reports, ran, force, progress, strict)
        reports[step.name] = report
        if report.action is Action.RAN:
            ran.add(step.name)
        finished(report)
    return list(reports.values())


def _run_step(
    step: Step, reports: Mapping[str, Report], ran: set[str], force: bool, progress: Progress, strict: bool
) -> Report:
    broken = next((name for name in step.needs if _stops(reports[name], step)), None)
    if broken is not None:
        return Report(step, Action.NOT_RUN, _why(reports[broken]), reports[broken].exit_code)
    state = _state(step, ran)
    if strict and not state.reason and _warned(step):
        state = State(step, "--strict, and the result has warnings")
    if not state.reason and not force and state.record is not None:
        return Report(step, Action.UP_TO_DATE, "", exit_code(state.record), record=state.record)
    try:
        done = carry_out(step.job, force, progress, strict=strict)
    except MetrocliError as error:
        return Report(step, Action.FAILED, state.reason or "forced", error.exit_code, error=str(error))
    return Report(step, Action.RAN, state.reason or "forced", exit_code(done.record), done, record=done.record)


def _warned(step: Step) -> bool:
    """Return whether the result of a step has warnings that are no doubts yet."""
    from metrocli.formats import hdf5

    result, record = hdf5.read(step.job.output)
    return not set(result.warnings) <= set(record.doubts)


def _stops(needed: Report, step: Step) -> bool:
    """Return whether a step cannot run after what happened to a job that it needs."""
    if needed.action in (Action.FAILED, Action.NOT_RUN):
        return True
    return needed.exit_code != 0 and not step.job.accept_doubtful


def _why(needed: Report) -> str:
    if needed.record is not None:
        return f"{needed.step.name}: {_unfit_words(needed.record)}"
    return f"{needed.step.name} {'failed' if needed.action is Action.FAILED else 'does not run'}"


def _unfit_words(record: Record) -> str:
    what = "its result is doubtful" if record.status == DOUBTFUL else "an acceptance criterion is not met"
    return f"{what}; --accept-doubtful uses it"


NOT_MET = 6
"""Exit code of a job that is done but is doubtful or does not meet an acceptance criterion"""


def exit_code(record: Record) -> int:
    """Return the exit code of a finished job."""
    return 0 if record.status == DONE else NOT_MET
