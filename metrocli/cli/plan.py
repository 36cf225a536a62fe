"""metrocli plan: what a planned measurement will determine, and a better one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrocli.cli import options
from metrocli.cli.console import Console, echo
from metrocli.tasks import KINDS

if TYPE_CHECKING:
    from metrocli.diagnosis.next_readings.choice import Next

_READINGS = 5
"""Number of readings that `--reveal` proposes"""


@click.command("plan", help="Show what a planned measurement will determine and how well, and propose a better one.")
@options.JOB
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder to write to (default: NAME.plan beside the job).",
)
@click.option(
    "--reveal", metavar="EFFECT[:PLACE]", help="Also propose five further readings that best show this effect."
)
@options.SET
@options.ACCEPT
@options.WRITES
def command(
    job: Path, out: Path | None, reveal: str | None, force: bool, as_json: bool, quiet: bool, **more: Any
) -> int:
    """Plan; write tables and files; print the expected uncertainties and the paths."""
    from metrocli.cli import summary, terminal
    from metrocli.cli.diagnosis_report.next_readings import next_lines
    from metrocli.diagnosis.next_readings.choice import as_data
    from metrocli.formats.own_files import refuse_inputs
    from metrocli.project import planned, runner
    from metrocli.project.job import JobOptions, kind_of_job, load

    console = Console(quiet)
    kind = kind_of_job(job)
    not_needed, accept = KINDS[kind].planned if kind else (), more["accept_doubtful"]
    loaded = load(job, JobOptions(more["overrides"], not_needed=not_needed, accept_doubtful=accept))
    folder = out if out is not None else loaded.file.with_name(f"{loaded.stem}.plan")
    planned.refuse_foreign(folder, force)
    plan = runner.plan(loaded)
    revealed = None if reveal is None else _revealing(job, reveal, more)
    text = summary.json_of_plan(plan, folder, {} if revealed is None else as_data(revealed))
    files = planned.files_of(plan)
    refuse_inputs((folder / name for name in files), (*loaded.stated_in, *loaded.files))
    written = list(planned.write(files, text, folder))
    if not as_json:
        for line in (terminal.plan_text(plan, loaded.text), *map(str, written)):
            console.print(line)
        if revealed is not None:
            console.print("\n".join(["", *next_lines(revealed)]))
    if as_json:
        echo(text)
    for line in plan.warnings:
        console.warning(line)
    return 0


def _revealing(job: Path, effect: str, more: dict[str, Any]) -> Next:
    """Return the further readings that best show an effect; readings that do not exist yet are simulated."""
    from metrocli.diagnosis.next_readings.choice import revealing
    from metrocli.project import diagnosed
    from metrocli.project.job import JobOptions, kind_of_job, load

    kind = kind_of_job(job)
    not_needed, accept = KINDS[kind].measured if kind else (), more["accept_doubtful"]
    loaded = load(job, JobOptions(more["overrides"], not_needed=not_needed, accept_doubtful=accept))
    adjusted, design = diagnosed.design_of(loaded)
    return revealing(adjusted, design, effect, _READINGS)
