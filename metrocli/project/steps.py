"""The jobs of a project, each after the jobs whose results it uses."""

from __future__ import annotations

import heapq
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from metrocli.errors import Fault, InputError, UsageError
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.project import PROJECT_FILE
from metrocli.project.campaign import CampaignPart, bound, parts_of, stem_of
from metrocli.project.heading import FileBeside
from metrocli.project.job import JobFile, JobOptions, load
from metrocli.project.named_files import absolute
from metrocli.project.yaml_text import YamlFiles
from metrocli.settings import BAD, ListOf, Section, Text, path_beside, setting
from metrocli.table import MOST_FAULTS
from metrocli.words import suggestion


@dataclass(frozen=True)
class ProjectFile:
    """The content of metrocli.yaml: jobs that may use each other's results."""

    jobs: tuple[str, ...] = setting(ListOf(Text(), distinct=True), "job files, relative to this file")
    project: str = setting(Text(), "name of the project", default="")
    effects_from: Node | None = setting(FileBeside(), "file with user-defined effects, for all its jobs", default=None)


@dataclass(frozen=True)
class ProjectStep:
    """One job of a project, with the names of the jobs whose results it uses."""

    name: str
    """The job file as written in the project"""
    job: JobFile
    needs: tuple[str, ...]


def project_file(place: Path) -> Path:
    """Return the metrocli.yaml of a folder, or the file itself; raise InputError if it does not exist."""
    path = place / PROJECT_FILE if place.is_dir() else place
    if not path.is_file():
        hint = f"a project is a folder with {PROJECT_FILE}: {{project: NAME, jobs: [jobs/a.yaml]}}"
        raise InputError([Fault("no such project file", str(path), hint=hint)])
    return path


def load_project(place: Path, accept_doubtful: bool = False) -> tuple[ProjectStep, ...]:
    """Return the jobs of a project, each after the jobs whose results it uses.

    With `accept_doubtful` they use results that are not fit for use. Raises InputError with the faults of all files.
    """
    path, files = project_file(place), YamlFiles()
    root = files.root(path)
    kind = root.get("job")
    if kind is not None and root.get("jobs") is None:
        hint = f"run a single job with the command of its kind: metrocli {kind.text} {path}"
        raise InputError([kind.fault("this is a job, not a project", hint)])
    faults: list[Fault] = []
    project = Section(ProjectFile).read(root, faults)
    if project is BAD:
        raise InputError(faults)
    listed = [entry for node in root.at("jobs").items for entry in _one_or_many(node, files, faults)]
    made = {absolute(output) for job in listed if (output := _peek_output(job)) is not None}
    jobs: dict[str, JobFile] = {}
    for step in listed:
        options = JobOptions(made=made, accept_doubtful=accept_doubtful, part=step.part, files=files)
        _load_one(step, options, jobs, faults)
    makers = _makers(listed, jobs, faults)
    if faults:
        raise InputError(faults)
    needs = {name: _needed(job, makers) for name, job in jobs.items()}
    return tuple(ProjectStep(name, jobs[name], needs[name]) for name in _ordered(listed, needs))


def name_of_project(place: Path) -> str:
    """Return the name that the project file states; empty without one."""
    node = YamlFiles().root(project_file(place)).get("project")
    return node.text if node is not None else ""


@dataclass(frozen=True)
class _Listed:
    """A job of the project: its place in metrocli.yaml, and the part that it is for."""

    node: Node
    root: Node | None
    """Of the job file; None if it cannot be read, which is reported when it is loaded"""
    part: CampaignPart | None = None

    @property
    def name(self) -> str:
        return f"{self.node.text}[{self.part.name}]" if self.part else self.node.text

    @property
    def path(self) -> Path:
        return path_beside(self.node)


def _one_or_many(node: Node, files: YamlFiles, faults: list[Fault]) -> list[_Listed]:
    """Return the job that a line of the project names, or one for each part if the job has `for:`.

    If its list of parts has faults, they are added and no job is returned.
    """
    try:
        root = files.root(path_beside(node))
    except InputError:
        return [_Listed(node, None)]
    try:
        parts = parts_of(root)
    except InputError as error:
        faults.extend(error.faults)
        return []
    return [_Listed(node, root, part) for part in parts] or [_Listed(node, root)]


def _peek_output(job: _Listed) -> Path | None:
    """Return the output of a job, None if it has faults (they are reported when it is loaded)."""
    if job.root is None:
        return None
    output = job.root.get("output")
    if output is None:
        return job.path.parent / "results" / f"{stem_of(job.path, job.part)}.h5"
    try:
        # the output alone: faults of other entries are reported when the job is loaded
        alone = replace(job.root, entries=((output, output),))
        return path_beside(bound(alone, job.part).entries[0][1] if job.part else output)
    except InputError:
        return None


def _load_one(job: _Listed, options: JobOptions, jobs: dict[str, JobFile], faults: list[Fault]) -> None:
    if not job.path.is_file():
        faults.append(job.node.fault(f"no such job file: {job.path}"))
        return
    try:
        jobs[job.name] = load(job.path, options)
    except InputError as error:
        # jobs of several parts share the faults of their file; the last ones only,
        # so that many jobs take no square of time
        faults.extend(fault for fault in error.faults if fault not in faults[-MOST_FAULTS:])


def _makers(listed: Sequence[_Listed], jobs: Mapping[str, JobFile], faults: list[Fault]) -> dict[Path, str]:
    """Return the name of the job that writes each result; adds a fault if two jobs write the same one."""
    makers: dict[Path, str] = {}
    for entry in listed:
        job = jobs.get(entry.name)
        if job is None:
            continue
        first = makers.setdefault(absolute(job.output), entry.name)
        if first != entry.name:
            place = job.root.get("output") or entry.node
            hint = "name another output" if entry.part is None else "write the part in braces into the output"
            faults.append(place.fault(f"two jobs write {job.output}: {first} and {entry.name}", hint))
    return makers


def _needed(job: JobFile, makers: Mapping[Path, str]) -> tuple[str, ...]:
    named = [path for item in job.inputs for path in item.paths]
    # a link to a result is that result
    paths = [place for path in named for place in (absolute(path), Path(os.path.realpath(path)))]
    return tuple(dict.fromkeys(makers[path] for path in paths if path in makers))


def _ordered(listed: Sequence[_Listed], needs: Mapping[str, tuple[str, ...]]) -> list[str]:
    """Return the names with each job after those it needs, otherwise in the order of the file.

    Raises InputError if jobs need each other in a circle.
    """
    place = {job.name: number for number, job in enumerate(listed) if job.name in needs}
    unmet = {name: set(before) for name, before in needs.items()}
    users: dict[str, list[str]] = {}
    for name, before in needs.items():
        for job in before:
            users.setdefault(job, []).append(name)
    # by their place in the file: the order of jobs is the same in each run
    ready = [(place[name], name) for name, before in unmet.items() if not before]
    heapq.heapify(ready)
    ordered: list[str] = []
    while ready:
        _, done = heapq.heappop(ready)
        ordered.append(done)
        for user in users.get(done, ()):
            unmet[user].discard(done)
            if not unmet[user]:
                heapq.heappush(ready, (place[user], user))
    if len(ordered) < len(place):
        chain = _cycle(next(name for name in place if unmet[name]), needs, set(ordered))
        at = next(job for job in listed if job.name == chain[0])
        raise InputError([at.node.fault(f"these jobs need each other's results: {' <- '.join(chain)}")])
    return ordered


def _cycle(name: str, needs: Mapping[str, tuple[str, ...]], ordered: Collection[str]) -> list[str]:
    """Return a circle of jobs, found by following unmet needs until a name appears again."""
    chain = [name]
    while chain.count(name) < 2:
        name = next(other for other in needs[name] if other not in ordered)
        chain.append(name)
    return chain[chain.index(name) :]


def selected(steps: Sequence[ProjectStep], only: Sequence[str], start: str | None) -> tuple[ProjectStep, ...]:
    """Return the jobs named in `only` with all that they need, or `start` with all that needs it; else all.

    A job is named as in the project, with or without its part, or by its result. Raises UsageError for a name that no
    job has.
    """
    if only:
        wanted = {step for name in only for step in _named(steps, name)}
        # what a job needs stands before it: one pass from the end finds all
        for step in reversed(steps):
            wanted |= set(step.needs) if step.name in wanted else set()
    elif start is not None:
        wanted = _named(steps, start)
        for step in steps:
            wanted |= {step.name} if wanted & set(step.needs) else set()
    else:
        return tuple(steps)
    return tuple(step for step in steps if step.name in wanted)


def _named(steps: Sequence[ProjectStep], name: str) -> set[str]:
    place = absolute(Path(name))
    names = {
        step.name
        for step in steps
        if name in (step.name, step.name.partition("[")[0])
        or place in (absolute(step.job.file), absolute(step.job.output))
    }
    if not names:
        hint = suggestion(name, [step.name for step in steps[:100]])
        raise UsageError(f"the project has no job '{name}'; {hint}")
    return names
