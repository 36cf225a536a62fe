"""metrocli gather: estimates and uncertainties of all results of a project, as one table."""

from __future__ import annotations

from pathlib import Path

import click

from metrocli.cli import options
from metrocli.cli.console import Console, echo
from metrocli.errors import UsageError


@click.command("gather", help="Write estimates and uncertainties of all results of a project into one CSV table.")
@click.argument("project", type=click.Path(path_type=Path), default=Path())
@click.option("--out", required=True, type=click.Path(path_type=Path), metavar="TABLE.csv", help="File to write.")
@click.option("--only", multiple=True, metavar="JOB", help="The results of this job (repeatable).")
@options.WRITES
def command(project: Path, out: Path, only: tuple[str, ...], force: bool, as_json: bool, quiet: bool) -> int:
    """Write the table; a row for each result, with whether it is up to date."""
    from metrocli.cli import summary
    from metrocli.formats import csv
    from metrocli.formats.own_files import refuse_inputs, write_all
    from metrocli.project.provenance.comparison import table_of
    from metrocli.project.staleness import states
    from metrocli.project.steps import load_project, selected

    if out.suffix.lower() not in ("", ".csv", ".txt"):
        raise UsageError(f"--out {out}: gather writes CSV, so name it {out.stem}.csv; `--json` prints the same numbers")
    steps = load_project(project, accept_doubtful=True)
    chosen = {step.name for step in selected(steps, only, None)}
    table = table_of(state for state in states(steps) if state.step.name in chosen)
    for step in steps:
        refuse_inputs([out], (*step.job.stated_in, *step.job.files, step.job.output))
    list(write_all({out: csv.to_text(table).encode()}, force))
    if as_json:
        echo(summary.json_of_table(table))
    else:
        Console(quiet).print(f"{out}: {len(table)} results")
    return 0
