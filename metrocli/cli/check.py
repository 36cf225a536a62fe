"""metrocli check: validate a job or a project without computing."""

from __future__ import annotations

from pathlib import Path

import click

from metrocli.cli import options
from metrocli.cli.console import Console


@click.command("check", help="Validate a job or a project, and the files they name, without computing.")
@click.argument("place", type=click.Path(path_type=Path), metavar="JOB.yaml|PROJECT")
@options.SET
@options.ACCEPT
@options.QUIET
def command(place: Path, overrides: tuple[str, ...], accept_doubtful: bool, quiet: bool) -> int:
    """Print `no faults` for each job; raise InputError with every fault otherwise."""
    from metrocli.errors import Fault, InputError, UsageError
    from metrocli.project.job import JobFile, Wishes, load
    from metrocli.project.runner import content, verify
    from metrocli.project.steps import FILE, load_project

    if place.is_dir() or place.name == FILE:
        if overrides:
            raise UsageError("--set changes one job, and this is a project: name the job file instead")
        jobs: list[JobFile] = [step.job for step in load_project(place, accept_doubtful)]
    else:
        jobs = [load(place, Wishes(overrides, accept_doubtful=accept_doubtful))]
    faults: list[Fault] = []
    for job in jobs:
        missing = [item.key for item in job.inputs if not all(path.exists() for path in item.paths)]
        try:
            held = content(job, missing)
            if not missing:
                verify(job, held)
        except InputError as error:
            faults.extend(error.faults)
    if faults:
        raise InputError(faults)
    for job in jobs:
        Console(quiet).print(f"{job.file}: no faults")
    return 0
