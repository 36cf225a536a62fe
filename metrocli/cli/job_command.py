"""The command of a kind of job, the same for all kinds."""

from __future__ import annotations

import os
from glob import glob
from pathlib import Path
from typing import Any

import click

from metrocli.cli import options
from metrocli.cli.console import Console, echo, echo_json
from metrocli.errors import Fault, InputError, UsageError
from metrocli.tasks import KINDS


def make(kind: str) -> click.Command:
    """Return the command that runs jobs of one kind."""

    questions = [options.asking(question) for question in KINDS[kind].questions]
    shared = [options.WORKERS, options.SCHEDULER] if KINDS[kind].chunked else []
    shared += [
        options.ACCEPT,
        options.STRICT,
        options.DRY_RUN,
        options.FORCE,
        options.JSON,
        options.QUIET,
        options.VERBOSE,
    ]

    described = KINDS[kind].described
    argument = options.job(required=not described)

    @options.all_of(argument, options.OUTPUT, options.SET, *map(options.asking, described), *questions, *shared)
    def command(job: Path | None, quiet: bool, verbose: bool, **flags: Any) -> int:
        path = job if job is not None and not described else _job_file(kind, job, flags)
        return _carry_out(kind, path, Console(quiet, verbose), flags)

    help_text = f"{KINDS[kind].summary[0].upper()}{KINDS[kind].summary[1:]}."
    return click.command(kind, help=help_text)(command)


def _job_file(kind: str, job: Path | None, flags: dict[str, Any]) -> Path:
    """Return the job file of the command, which is written beside the result if options describe the job."""
    options_given = {question.name: flags.pop(question.name) for question in KINDS[kind].described}
    values = [value for value in options_given.values() if value]
    names = " and ".join(f"--{name}" for name in options_given)
    if job is not None and values:
        raise UsageError(f"{job} beside {names}: name a job or describe it; put a pattern of file names in quotes")
    if job is not None:
        return job
    if len(values) < len(options_given):
        raise UsageError(f"name a job file, or describe the job by {names}")
    from metrocli.formats.own_files import write_all

    result = flags["output"] or Path("camera.h5")
    path = result.with_suffix(".yaml")
    files, *others = values
    count = len(glob(files))
    text = KINDS[kind].job_of(os.path.relpath(files, path.parent), *others, result.name, count)
    if not count:
        raise InputError([Fault(f"--images: no file matches '{files}'")])
    flags["output"] = None
    list(write_all({path: text.encode()}, flags["force"]))
    return path


def _carry_out(kind: str, path: Path, console: Console, flags: dict[str, Any]) -> int:
    """Load the job; then check it (--dry-run), answer a question about it or run it; print the outcome."""
    from metrocli.formats.hdf5 import refuse_foreign
    from metrocli.project import runner
    from metrocli.project.job import JobOptions, load

    output, accept = options.result_file(flags["output"]), flags["accept_doubtful"]
    job = load(path, JobOptions(flags["overrides"], output, kind, accept_doubtful=accept))
    question = next((question.name for question in KINDS[kind].questions if flags[question.name]), None)
    if flags["dry_run"]:
        if not flags["force"]:
            refuse_foreign(job.output, kind)
        runner.verify(job)
        if flags["as_json"]:
            echo_json({"job": str(path), "status": "no faults", "result": str(job.output)})
        else:
            console.print(f"{path}: no faults; would write {job.output}")
        return 0
    from metrocli.cli import columns, summary, terminal

    if question is not None:
        table = runner.answer(job, question)
        echo(summary.json_of_table(table) if flags["as_json"] else columns.table_text(table))
        return 0
    from metrocli.uncertainty.workers import Workers

    workers = Workers(flags.get("workers", 0), flags.get("scheduler", ""))
    done = runner.carry_out(job, flags["force"], console, workers, flags["strict"])
    if flags["as_json"]:
        echo(summary.json_of(done.result, done.record, done.path))
    else:
        console.print(terminal.result_text(done.result, done.record, done.path))
    for line in done.result.warnings:
        console.warning(line)
    return terminal.print_unfit(done.record, printed=not (flags["as_json"] or console.quiet))
