"""A project: its jobs in order, and which results are out of date and why; judged by content, never by time."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from metrocli import __version__
from metrocli.errors import Fault, InputError, MetrocliError
from metrocli.nodes import Node
from metrocli.project import yaml_text
from metrocli.project.inputs import input_files
from metrocli.project.job import JobFile, Wishes, load
from metrocli.project.runner import Done, Progress, carry_out
from metrocli.record import Record
from metrocli.settings import BAD, ListOf, Section, Text, path_beside, setting

FILE = "metrocli.yaml"


@dataclass(frozen=True)
class ProjectFile:
    """The content of metrocli.yaml: jobs that may use each other's results."""

    jobs: tuple[str, ...] = setting(ListOf(Text(), distinct=True), "job files, relative to this file")
    project: str = setting(Text(), "name of the project", default="")


@dataclass(frozen=True)
class Step:
    """One job of a project, with the names of the jobs whose results it uses."""

    name: str
    """The job file as written in the project"""
    job: JobFile
    needs: tuple[str, ...]


@dataclass(frozen=True)
class State:
    """Whether the result of a step is up to date; `reason` states why not and is empty if it is."""

    step: Step
    reason: str
    record: Record | None = None


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


def project_file(place: Path) -> Path:
    """Return the metrocli.yaml of a folder, or the file itself; raise InputError if it does not exist."""
    path = place / FILE if place.is_dir() else place
    if not path.is_file():
        hint = f"a project is a folder with {FILE}: {{project: NAME, jobs: [jobs/a.yaml]}}"
        raise InputError([Fault("no such project file", str(path), hint=hint)])
    return path


def load_project(place: Path) -> tuple[Step, ...]:
    """Return the jobs of a project, each after the jobs whose results it uses.

    Raises InputError with the faults of all files.
    """
    path = project_file(place)
    root = yaml_text.parse(yaml_text.read_text(path, str(path)), str(path), path.parent)
    kind = root.get("job")
    if kind is not None and root.get("jobs") is None:
        hint = f"run a single job with the command of its kind: metrocli {kind.text} {path}"
        raise InputError([kind.fault("this is a job, not a project", hint)])
    faults: list[Fault] = []
    project = Section(ProjectFile).read(root, faults)
    if project is BAD:
        raise InputError(faults)
    nodes = root.at("jobs").items
    made = {_absolute(output) for node in nodes if (output := _peek_output(path_beside(node))) is not None}
    jobs: dict[str, JobFile] = {}
    for node in nodes:
        _load_one(node, path_beside(node), made, jobs, faults)
    makers = _makers(nodes, jobs, faults)
    if faults:
        raise InputError(faults)
    needs = {name: _needed(job, makers) for name, job in jobs.items()}
    return tuple(Step(name, jobs[name], needs[name]) for name in _ordered(nodes, needs))


def _absolute(path: Path) -> Path:
    return Path(os.path.abspath(path))


def _peek_output(path: Path) -> Path | None:
    """Return the output of a job file, None if the file has faults (they are reported when it is loaded)."""
    try:
        output = yaml_text.parse(yaml_text.read_text(path, str(path)), str(path), path.parent).get("output")
    except InputError:
        return None
    return path_beside(output) if output is not None else path.parent / "results" / f"{path.stem}.h5"


def _load_one(node: Node, path: Path, made: set[Path], jobs: dict[str, JobFile], faults: list[Fault]) -> None:
    if not path.is_file():
        faults.append(node.fault(f"no such job file: {path}"))
        return
    try:
        jobs[node.text] = load(path, Wishes(made=made))
    except InputError as error:
        faults.extend(error.faults)


def _makers(nodes: Sequence[Node], jobs: Mapping[str, JobFile], faults: list[Fault]) -> dict[Path, str]:
    """Return the name of the job that writes each result; adds a fault if two jobs write the same one."""
    makers: dict[Path, str] = {}
    for node in nodes:
        job = jobs.get(node.text)
        if job is None:
            continue
        first = makers.setdefault(_absolute(job.output), node.text)
        if first != node.text:
            place = job.root.get("output") or node
            faults.append(place.fault(f"two jobs write {job.output}: {first} and {node.text}", "name another output"))
    return makers


def _needed(job: JobFile, makers: Mapping[Path, str]) -> tuple[str, ...]:
    paths = (_absolute(path) for item in job.inputs for path in item.paths)
    return tuple(dict.fromkeys(makers[path] for path in paths if path in makers))


def _ordered(nodes: Sequence[Node], needs: Mapping[str, tuple[str, ...]]) -> list[str]:
    """Return the names with each job after those it needs, otherwise in the order of the file.

    Raises InputError if jobs need each other in a circle.
    """
    ordered: list[str] = []
    waiting = [node for node in nodes if node.text in needs]
    while waiting:
        ready = next((node for node in waiting if set(needs[node.text]) <= set(ordered)), None)
        if ready is None:
            chain = _cycle(waiting[0].text, needs, ordered)
            place = next(node for node in waiting if node.text == chain[0])
            raise InputError([place.fault(f"these jobs need each other's results: {' <- '.join(chain)}")])
        ordered.append(ready.text)
        waiting.remove(ready)
    return ordered


def _cycle(name: str, needs: Mapping[str, tuple[str, ...]], ordered: Sequence[str]) -> list[str]:
    """Return a circle of jobs, found by following unmet needs until a name appears again."""
    chain = [name]
    while chain.count(name) < 2:
        name = next(other for other in needs[name] if other not in ordered)
        chain.append(name)
    return chain[chain.index(name) :]


def states(steps: Iterable[Step]) -> Iterator[State]:
    """Yield for each step whether it would run and why; a step also runs if a job runs whose result it uses."""
    steps = tuple(steps)
    _refuse_lost(steps)
    would_run: set[str] = set()
    for step in steps:
        state = _state(step, would_run)
        if state.reason:
            would_run.add(step.name)
        yield state


def _refuse_lost(steps: Sequence[Step]) -> None:
    """Raise InputError for each input of the last result that no longer exists, such as one image of a file pattern.

    Without this, a job would silently run with fewer images.
    """
    from metrocli.formats import hdf5

    faults = []
    made = {_absolute(step.job.output) for step in steps}
    for step in steps:
        try:
            _, record = hdf5.read_record(step.job.output) if step.job.output.exists() else ("", None)
        except InputError:
            continue
        if record is not None and record.job_text == step.job.text:
            paths = [item.path for item in record.inputs if _absolute(step.job.folder / item.path) not in made]
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


def run(steps: Sequence[Step], force: bool, progress: Progress, finished: Callable[[Report], Any]) -> list[Report]:
    """Bring every result up to date; call `finished` with the report of each job.

    After a failure, jobs that need the missing result do not run; all others do.
    """
    if not force:
        _refuse_lost(steps)
    reports: dict[str, Report] = {}
    ran: set[str] = set()
    for step in steps:
        report = _run_step(step, reports, ran, force, progress)
        reports[step.name] = report
        if report.action is Action.RAN:
            ran.add(step.name)
        finished(report)
    return list(reports.values())


def _run_step(step: Step, reports: Mapping[str, Report], ran: set[str], force: bool, progress: Progress) -> Report:
    broken = next((name for name in step.needs if reports[name].action in (Action.FAILED, Action.NOT_RUN)), None)
    if broken is not None:
        return Report(step, Action.NOT_RUN, f"{broken} failed", reports[broken].exit_code)
    state = _state(step, ran)
    if not state.reason and not force and state.record is not None:
        return Report(step, Action.UP_TO_DATE, "", _exit_code(state.record))
    try:
        done = carry_out(step.job, force, progress)
    except MetrocliError as error:
        return Report(step, Action.FAILED, state.reason or "forced", error.exit_code, error=str(error))
    return Report(step, Action.RAN, state.reason or "forced", _exit_code(done.record), done)


def _exit_code(record: Record) -> int:
    """Return the exit code of a finished job."""
    return 0 if all(verdict.met for verdict in record.verdicts) else NOT_MET


NOT_MET = 6
"""Exit code of a job that is done but does not meet an acceptance criterion"""
