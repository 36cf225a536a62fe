"""metrocli check: validate a job or a project without computing."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from metrocli.cli import options
from metrocli.cli.console import Console, echo_json
from metrocli.errors import Fault, InputError, UsageError
from metrocli.formats.file_bytes import refuse_unwritable
from metrocli.project import PROJECT_FILE

if TYPE_CHECKING:
    from metrocli.project.job import JobFile


@click.command("check", help="Validate a job or a project, and the files they name, without computing.")
@click.argument("place", type=click.Path(path_type=Path), metavar="JOB.yaml|PROJECT")
@options.SET
@options.ACCEPT
@options.JSON
@options.QUIET
def command(place: Path, overrides: tuple[str, ...], accept_doubtful: bool, as_json: bool, quiet: bool) -> int:
    """Print `no faults` for each job, and its files outside the project; raise InputError with every fault otherwise.

    A foreign file at the output is a fault too: `run` would not replace it. A result that `run` would replace is not
    judged.
    """
    from metrocli.formats.hdf5 import refuse_foreign
    from metrocli.project.job import JobOptions, load_parts
    from metrocli.project.named_files import absolute
    from metrocli.project.runner import verify
    from metrocli.project.staleness import states
    from metrocli.project.steps import load_project

    renewed: set[Path] = set()
    if place.is_dir() or place.name == PROJECT_FILE:
        if overrides:
            raise UsageError("--set changes one job, and this is a project: name the job file instead")
        steps = load_project(place, accept_doubtful)
        jobs: list[JobFile] = [step.job for step in steps]
        renewed = {absolute(state.step.job.output) for state in states(steps) if state.reason and not state.waits}
    else:
        jobs = load_parts(place, JobOptions(overrides, accept_doubtful=accept_doubtful))
    faults: list[Fault] = []
    for job in jobs:
        foreign = partial(refuse_foreign, job.output, job.kind)
        for look in (partial(verify, job, renewed), partial(refuse_unwritable, job.output), foreign):
            try:
                look()
            except InputError as error:
                faults.extend(error.faults)
    if faults:
        raise InputError(faults)
    root = place if place.is_dir() else place.parent
    within = (root / PROJECT_FILE).is_file()
    checked = [(_name(job), _outside(job, root) if within else []) for job in jobs]
    if as_json:
        rows = [{"job": name, "outside": outside} for name, outside in checked]
        echo_json({"status": "no faults", "jobs": rows})
    console = Console(quiet or as_json)
    for name, outside in checked:
        console.print(f"{name}: no faults")
        for path in outside:
            console.print(f"{name}: names a file outside the project: {path}")
    return 0


def _name(job: JobFile) -> str:
    part = job.options.part
    return f"{job.file}[{part.name}]" if part is not None else str(job.file)


def _outside(job: JobFile, root: Path) -> list[str]:
    """Return the inputs and the output of a job that lie outside the project, links followed."""
    home = os.path.realpath(root) + os.sep
    named = [*job.files, job.output]
    return [str(path) for path in dict.fromkeys(named) if not os.path.realpath(path).startswith(home)]
