"""metrocli plan: what a planned measurement will determine, and a better one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from metrocli.cli import options
from metrocli.cli.console import Console, echo


@click.command("plan", help="Show what a planned measurement will determine and how well, and propose a better one.")
@options.JOB
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder to write to (default: NAME.plan beside the job).",
)
@options.SET
@options.ACCEPT
@options.FORCE
@options.JSON
@options.QUIET
def command(job: Path, out: Path | None, force: bool, as_json: bool, quiet: bool, **wishes: Any) -> int:
    """Plan; write tables and files; print the expected uncertainties and the paths."""
    from metrocli.cli import summary, terminal
    from metrocli.project import planned, runner
    from metrocli.project.job import Wishes, kind_of_job, load
    from metrocli.tasks import KINDS

    console = Console(quiet)
    folder = out if out is not None else job.with_name(f"{job.stem}.plan")
    planned.refuse_foreign(folder, force)
    kind = kind_of_job(job)
    not_needed, accept = KINDS[kind].planned if kind else (), wishes["accept_doubtful"]
    loaded = load(job, Wishes(wishes["overrides"], not_needed=not_needed, accept_doubtful=accept))
    plan = runner.plan(loaded)
    text = summary.json_of_plan(plan, folder)
    written = list(planned.write(planned.files_of(plan), text, folder))
    if not as_json:
        for line in (terminal.plan_text(plan, loaded.text), *map(str, written)):
            console.print(line)
    if as_json:
        echo(text)
    for line in plan.warnings:
        console.warning(line)
    return 0
