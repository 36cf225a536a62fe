"""Job files: YAML text to a frozen JobFile; all faults are reported at once."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable
from dataclasses import field, replace
from functools import cache
from pathlib import Path
from typing import Any

from metrocli import tasks
from metrocli.effects import requested as effects
from metrocli.effects.own import columns
from metrocli.effects.requested import RequestedEffect
from metrocli.errors import Fault, InputError, UsageError
from metrocli.formats.csv_text import numeric
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.project import yaml_text
from metrocli.project.campaign import KEY as CAMPAIGN
from metrocli.project.campaign import CampaignPart, bound, named_part, parts_of, stem_of
from metrocli.project.heading import Heading
from metrocli.project.named_files import Input, inputs_of, missing
from metrocli.project.own_effects import Defining, Package, UserEffects, own_effects
from metrocli.project.ranges import effect_node, overridden, ranges_of, within
from metrocli.project.requirements import figures_of
from metrocli.project.yaml_text import YamlFiles
from metrocli.settings import BAD, Schema, read_sections, sections_schema, settings_of
from metrocli.tasks.job import Task


@dataclass(frozen=True)
class JobFile:
    """A job file that has no faults."""

    file: Path
    """As the user named it."""
    heading: Heading
    settings: Any
    inputs: tuple[Input, ...]
    output: Path
    text: str
    """The text of the job as used, after --set."""
    root: Node
    effects: tuple[RequestedEffect, ...] = ()
    options: JobOptions = field(default_factory=lambda: JobOptions())
    """What the command line asked for when it was loaded"""
    own: UserEffects = field(default_factory=UserEffects)
    """User-defined effects, which extend the table of the kind"""

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that it reads beside its own text: inputs, and user-defined effects."""
        return (*(path for item in self.inputs for path in item.paths), *self.own.files)

    @property
    def stated_in(self) -> tuple[Path, ...]:
        """The files that state the job: its own, the list of its part, and a project that names effects for it."""
        parts = self.options.part.list if self.options.part is not None else None
        return tuple(path for path in (self.file, parts.path if parts else None, self.own.project) if path is not None)

    @property
    def effects_of_packages(self) -> tuple[str, ...]:
        """The names of the effects of packages that it uses."""
        return tuple(sorted({effect.name for effect in self.effects} & self.own.packages.keys()))

    @property
    def packages(self) -> tuple[Package, ...]:
        """The packages whose effects it uses."""
        used = (self.own.packages[name] for name in self.effects_of_packages)
        return tuple({package.state: package for package in used}.values())

    @property
    def accept_doubtful(self) -> bool:
        """Whether results that are doubtful, or do not meet their requirements, are accepted as inputs."""
        return self.options.accept_doubtful

    @property
    def kind(self) -> str:
        """The kind of the job."""
        return self.heading.job

    @property
    def stem(self) -> str:
        """Its name in those of files made from it."""
        return stem_of(self.file, self.options.part)

    @property
    def folder(self) -> Path:
        """The folder to which paths in the job are relative."""
        return self.file.parent


@dataclass(frozen=True)
class JobOptions:
    """What the command line asks for beyond the job file."""

    overrides: tuple[str, ...] = ()
    """The values of --set, each `key.path=value`"""
    output: Path | None = None
    kind: str | None = None
    """The kind of the command, None for any"""
    made: Collection[Path] = ()
    """Absolute paths of results that other jobs will write"""
    not_needed: Collection[str] = ()
    """Keys of inputs whose files may be missing"""
    effects: tuple[str, ...] = ()
    """The values of --effect, each `NAME:key=value,...`"""
    accept_doubtful: bool = False
    text: str | None = None
    """The text of the job, where it is not that of its file"""
    part: CampaignPart | None = None
    """The part that a job is loaded for, if its file is for many"""
    files: YamlFiles = field(default_factory=YamlFiles, compare=False)
    """YAML files that were read for other jobs at the same time"""

    def elsewhere(self) -> JobOptions:
        """Return them for a process that loads the job again when all its inputs exist, and needs no list of parts."""
        return replace(self, made=(), files=YamlFiles(), part=self.part and replace(self.part, list=None))


def load(path: Path, options: JobOptions | None = None) -> JobFile:
    """Return a job; the path `JOB.yaml[PART]` names one part of a job for many.

    Raises InputError with all faults of the file and its YAML inputs, UsageError if the job is of another kind.
    """
    options = options or JobOptions()
    path, options, faults = *_named(path, options), list[Fault]()
    root, text = _stated(path, options, faults)
    read = _read(root, path, options, faults)
    read, requests, own = _with_effects(read, path, options, faults)
    inputs, output = _checked(read, requests, path, options, faults)
    return JobFile(path, read.heading, read.settings, inputs, output, text, root, requests, options, own)


@dataclass(frozen=True)
class _ReadJob:
    """A job whose keys were read; where they have a fault, heading and settings are BAD."""

    root: Node
    kind: str
    heading: Any
    settings: Any
    named: tuple[Node, ...]
    """The effects that the job and the command line want"""
    inputs: tuple[Input, ...]


def _stated(path: Path, options: JobOptions, faults: list[Fault]) -> tuple[Node, str]:
    """Return the tree and the text of a job as it is used: with what the command line overrides, for its part."""
    root, text = _root(path, options, faults)
    if options.part is not None:
        root = bound(root, options.part)
        text = yaml_text.emit(root, f"{path.name}, for {options.part.name}")
    elif root.get(CAMPAIGN) is not None:
        hint = f"name one part: '{path}[PART]', in quotes; or list the job in metrocli.yaml, and use: metrocli run"
        raise InputError([root.at(CAMPAIGN).fault("this file is a job for each of many parts", hint)])
    return root, text


def _read(root: Node, path: Path, options: JobOptions, faults: list[Fault]) -> _ReadJob:
    """Return what the keys of a job say; raise InputError if its kind is not known."""
    more = tuple(effect_node(effect, path.parent) for effect in options.effects)
    kind = _kind(root, path, options)
    if kind is None:
        known = tuple(entry for entry in root.entries if entry[0].text in settings_of(Heading))
        read_sections(replace(root, entries=known), (Heading,), faults)
        raise InputError(_in_order(faults))
    section = tasks.KINDS[kind].settings()
    heading, settings = read_sections(root, (Heading, section), faults)
    named = (*(heading.effects if heading is not BAD else ()), *more)
    return _ReadJob(root, kind, heading, settings, named, inputs_of(root, section, faults))


def _with_effects(
    job: _ReadJob, path: Path, options: JobOptions, faults: list[Fault]
) -> tuple[_ReadJob, tuple[RequestedEffect, ...], UserEffects]:
    """Return a job that reads the columns of its user-defined effects, the effects that it wants, and its own."""
    task, files = tasks.KINDS[job.kind].task(), [(item.spec, item.paths) for item in job.inputs]
    further = cache(lambda: columns.variables(files, numeric))
    places = cache(lambda: columns.with_variables(task.places, further(), columns.refused(files, numeric)))
    defining = Defining(job.kind, path, places, options.files, effects.names_of(job.named))
    own = UserEffects() if job.heading is BAD else own_effects(job.heading, defining, faults)
    if any(effect.definition for effect in own.effects):
        specs = [replace(item, spec=columns.reading(item.spec, further(), own.effects)) for item in job.inputs]
        job = replace(job, inputs=tuple(specs))
    requests = effects.read((*task.effects, *own.effects), job.named, faults) if job.named else ()
    return job, (*requests, *_correlated(job, task, faults), *_variance_groups(job, task, faults)), own


def _correlated(job: _ReadJob, task: Task[Any, Any], faults: list[Fault]) -> tuple[RequestedEffect, ...]:
    """Return the correlated errors that a job states, if its kind can have them."""
    if job.heading is BAD or not job.heading.correlated:
        return ()
    node = job.root.at("correlated")
    if task.covariates is None:
        faults.append(node.fault(f"{job.kind} jobs take no `correlated`", "write noise: structured"))
        return ()
    from metrocli.effects import correlated

    return correlated.requests_of(job.heading.correlated, node.items, task.covariates)


def _variance_groups(job: _ReadJob, task: Task[Any, Any], faults: list[Fault]) -> tuple[RequestedEffect, ...]:
    """Return the variance groups that a job states, if its kind adjusts readings of several places."""
    if job.heading is BAD or not job.heading.variance_groups:
        return ()
    node = job.root.at("variance_groups")
    if task.diagnosed is None:
        faults.append(node.fault(f"{job.kind} jobs take no `variance_groups`", "leave them out"))
        return ()
    from metrocli.effects import variance_groups

    return variance_groups.requests_of(job.heading.variance_groups, node.items)


def _checked(
    job: _ReadJob, requests: tuple[RequestedEffect, ...], path: Path, options: JobOptions, faults: list[Fault]
) -> tuple[tuple[Input, ...], Path]:
    """Return the inputs within the ranges of the job, and its output; raise InputError with all faults."""
    heading, inputs = job.heading, job.inputs
    named = sum(request.is_in_table for request in requests)
    if heading is not BAD and job.settings is not BAD and heading.require and named >= len(job.named):
        known = figures_of(job.kind, job.settings, requests)
        for requirement in heading.require:
            requirement.limit_among(known, faults)
    if heading is not BAD and heading.ranges:
        ranges = ranges_of(heading.ranges, [item.spec for item in inputs], faults)
        inputs = tuple(replace(item, spec=within(item.spec, ranges)) for item in inputs)
    faults.extend(missing(inputs, options.not_needed, options.made))
    if faults:
        raise InputError(_in_order(faults))
    output = options.output or heading.output or path.parent / "results" / f"{stem_of(path, options.part)}.h5"
    if os.path.realpath(output) in {os.path.realpath(file) for item in inputs for file in item.paths}:
        raise InputError([job.root.at("output").fault(f"the output {output} is one of the inputs", "name another one")])
    return inputs, output


def load_parts(path: Path, options: JobOptions) -> list[JobFile]:
    """Return the job of a file, or one for each part if it is for many; raises as `load`."""
    path, options = _named(path, options)
    parts = () if options.part else parts_of(_root(path, options, [])[0])
    return [load(path, replace(options, part=part)) for part in parts] or [load(path, options)]


def kind_of_job(path: Path) -> str | None:
    """Return the kind of a job file, or None if it names no known kind."""
    path, options = _named(path, JobOptions())
    return _kind(_root(path, options, [])[0], path, options)


def _named(path: Path, options: JobOptions) -> tuple[Path, JobOptions]:
    """Return the file of a job, and the options with the part that its path names."""
    file, part = named_part(path, lambda file: _root(file, options, [])[0])
    return file, replace(options, part=part or options.part)


def _root(path: Path, options: JobOptions, faults: list[Fault]) -> tuple[Node, str]:
    """Return the tree of a job file with the overrides applied, and the equivalent YAML text.

    A fault for each repeated key is added to `faults`.
    """
    if options.text is None:
        held = options.files.read(path)
        root, text = held.root, held.text
        faults.extend(held.repeated)
    else:
        text = options.text
        root = yaml_text.parse(text, str(path), path.parent, faults)
    if root.kind != "mapping":
        raise InputError([root.fault("a job file must be a mapping of keys", "write 'metrocli: 1', 'job: KIND', ...")])
    for override in options.overrides:
        root = overridden(root, override, path.parent)
    if options.overrides:
        used = ", ".join(f"--set {override}" for override in options.overrides)
        text = yaml_text.emit(root, f"as used, with {used}")
    return root, text


def _kind(root: Node, path: Path, options: JobOptions) -> str | None:
    """Return the kind of a job, or None if it is unknown; raise UsageError if it is not the one that is asked for."""
    node = root.get("job")
    kind = node.text if node is not None and node.kind == "scalar" and node.text in tasks.KINDS else None
    if kind is not None and options.kind not in (None, kind):
        job = f'"{path}[{options.part.name}]"' if options.part else path
        raise UsageError(f"{path} is a job of the kind {kind}; use: metrocli {kind} {job}")
    return kind


def _in_order(faults: Iterable[Fault]) -> list[Fault]:
    return sorted(faults, key=lambda fault: (fault.file, fault.line or 0, fault.column or 0))


def schema(kind: str) -> Schema:
    """Return the JSON schema (2020-12) of a kind of job, for editors."""
    own = sections_schema((Heading, tasks.KINDS[kind].settings()))
    own["properties"]["effects"] |= effects.schema(tasks.KINDS[kind].task().effects)
    own["properties"]["job"] = {"const": kind, "description": "kind of job"}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"metrocli {kind}", **own}
