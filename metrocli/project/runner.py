"""One job from file to result: the only place that knows the sequence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from metrocli import __version__, tasks
from metrocli.effects.wanted import planted
from metrocli.errors import Fault, InputError, UsageError
from metrocli.plan import Plan
from metrocli.project.chunks import ChunkFolder
from metrocli.project.inputs import input_files, read_inputs
from metrocli.project.job import Job
from metrocli.record import Record, Verdict
from metrocli.result import Result
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import Table
from metrocli.uncertainty.workers import Workers

HERE = Workers()
"""All cores of this machine"""
Say = Callable[[str], None]
"""Takes a line of progress."""


@dataclass(frozen=True)
class Done:
    """A job that was carried out and written."""

    result: Result
    record: Record
    path: Path


def carry_out(job: Job, force: bool = False, say: Say = lambda line: None, workers: Workers = HERE) -> Done:
    """Read the inputs, run the task, judge and write; nothing is written where anything is wrong.

    The chunks that `workers` finish are kept beside the output until the job is done, so that a killed run goes on.
    """
    refuse_foreign(job.output, job.kind, force)
    files = input_files(job)
    say(f"{job.file}: reading {len(files)} input files")
    held = read_inputs(job)
    say(f"{job.file}: {job.kind}")
    if tasks.KINDS[job.kind].chunked:
        held["workers"] = replace(workers, finished=ChunkFolder(job.output.with_suffix(".chunks")))
    result: Result = tasks.load(job.kind).run(job.settings, **held, **_effects(job))
    result = replace(result, title=result.title or job.heading.title, warnings=_noticed(held) + result.warnings)
    created = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    record = Record(job.text, files, __version__, created, _judged(job, result))
    from metrocli.formats import hdf5

    hdf5.write(job.output, result, record)
    return Done(result, record, job.output)


def verify(job: Job, held: dict[str, Any]) -> None:
    """Raise InputError with what a kind finds wrong with a job and its inputs together, without computing."""
    check = getattr(tasks.load(job.kind), "check", None)
    if check is not None:
        check(job.settings, **held, **_effects(job))


def answer(job: Job, question: str) -> Table:
    """Return what a task's other function (`compare`, ...) says of a job; nothing is written."""
    table: Table = getattr(tasks.load(job.kind), question)(job.settings, **read_inputs(job), **_effects(job))
    return table


def simulated_inputs(kind: str) -> tuple[str, ...]:
    """Return the inputs that the simulation of a kind makes, and that need not exist."""
    return tuple(getattr(tasks.load(kind), "SIMULATED", ()))


def simulate(job: Job, options: SimulationOptions) -> Simulation:
    """Return the measurement that the model of a job predicts."""
    module = tasks.load(job.kind)
    if not hasattr(module, "simulate"):
        raise UsageError(f"{job.kind} has no simulation")
    job = replace(job, effects=planted(job.effects))
    held = read_inputs(job, simulated_inputs(job.kind))
    simulation: Simulation = module.simulate(job.settings, options, **held, **_effects(job))
    return simulation


def planned_inputs(kind: str) -> tuple[str, ...]:
    """Return the inputs that do not exist before a measurement of a kind is made."""
    return tuple(getattr(tasks.load(kind), "PLANNED", simulated_inputs(kind)))


def plan(job: Job) -> Plan:
    """Return what the measurement that a job describes will determine."""
    module = tasks.load(job.kind)
    if not hasattr(module, "plan"):
        raise UsageError(f"{job.kind} has no plan")
    made: Plan = module.plan(job.settings, **read_inputs(job, planned_inputs(job.kind)), **_effects(job))
    return made


def _effects(job: Job) -> dict[str, Any]:
    """Return the keyword of a task that takes effects; none where the job names none."""
    return {"effects": job.effects} if job.effects else {}


def refuse_foreign(path: Path, kind: str, force: bool) -> None:
    """Raise InputError where `path` holds something other than a result of this kind, unless forced."""
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


def _noticed(held: dict[str, Any]) -> tuple[str, ...]:
    return tuple(line for value in held.values() if isinstance(value, Table) for line in value.warnings)


def _judged(job: Job, result: Result) -> tuple[Verdict, ...]:
    faults: list[Fault] = []
    verdicts = [requirement.verdict(result, faults) for requirement in job.heading.require]
    if faults:
        raise InputError(faults)
    return tuple(verdict for verdict in verdicts if verdict is not None)
