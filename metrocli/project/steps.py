"""The jobs of a project, each after the jobs whose results it uses."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from metrocli.errors import Fault, InputError
from metrocli.nodes import Node
from metrocli.project import yaml_text
from metrocli.project.job import JobFile, Wishes, load
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


def project_file(place: Path) -> Path:
    """Return the metrocli.yaml of a folder, or the file itself; raise InputError if it does not exist."""
    path = place / FILE if place.is_dir() else place
    if not path.is_file():
        hint = f"a project is a folder with {FILE}: {{project: NAME, jobs: [jobs/a.yaml]}}"
        raise InputError([Fault("no such project file", str(path), hint=hint)])
    return path


def load_project(place: Path, accept_doubtful: bool = False) -> tuple[Step, ...]:
    """Return the jobs of a project, each after the jobs whose results it uses.

    With `accept_doubtful` they use results that are not fit for use. Raises InputError with the faults of all files.
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
    made = {absolute(output) for node in nodes if (output := _peek_output(path_beside(node))) is not None}
    jobs: dict[str, JobFile] = {}
    for node in nodes:
        _load_one(node, path_beside(node), Wishes(made=made, accept_doubtful=accept_doubtful), jobs, faults)
    makers = _makers(nodes, jobs, faults)
    if faults:
        raise InputError(faults)
    needs = {name: _needed(job, makers) for name, job in jobs.items()}
    return tuple(Step(name, jobs[name], needs[name]) for name in _ordered(nodes, needs))


def name_of_project(place: Path) -> str:
    """Return the name that the project file states; empty without one."""
    path = project_file(place)
    node = yaml_text.parse(yaml_text.read_text(path, str(path)), str(path), path.parent).get("project")
    return node.text if node is not None else ""


def absolute(path: Path) -> Path:
    """Return the absolute path of a file, without following links."""
    return Path(os.path.abspath(path))


def _peek_output(path: Path) -> Path | None:
    """Return the output of a job file, None if the file has faults (they are reported when it is loaded)."""
    try:
        output = yaml_text.parse(yaml_text.read_text(path, str(path)), str(path), path.parent).get("output")
    except InputError:
        return None
    return path_beside(output) if output is not None else path.parent / "results" / f"{path.stem}.h5"


def _load_one(node: Node, path: Path, wishes: Wishes, jobs: dict[str, JobFile], faults: list[Fault]) -> None:
    if not path.is_file():
        faults.append(node.fault(f"no such job file: {path}"))
        return
    try:
        jobs[node.text] = load(path, wishes)
    except InputError as error:
        faults.extend(error.faults)


def _makers(nodes: Sequence[Node], jobs: Mapping[str, JobFile], faults: list[Fault]) -> dict[Path, str]:
    """Return the name of the job that writes each result; adds a fault if two jobs write the same one."""
    makers: dict[Path, str] = {}
    for node in nodes:
        job = jobs.get(node.text)
        if job is None:
            continue
        first = makers.setdefault(absolute(job.output), node.text)
        if first != node.text:
            place = job.root.get("output") or node
            faults.append(place.fault(f"two jobs write {job.output}: {first} and {node.text}", "name another output"))
    return makers


def _needed(job: JobFile, makers: Mapping[Path, str]) -> tuple[str, ...]:
    paths = (absolute(path) for item in job.inputs for path in item.paths)
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
