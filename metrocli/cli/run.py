"""metrocli run: bring every result of a project up to date."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrocli.cli import options
from metrocli.cli.console import Console, echo
from metrocli.record import DOUBTFUL, NOT_MET, UNMET

if TYPE_CHECKING:
    from metrocli.project.pipeline import Report
    from metrocli.project.staleness import State


@click.command(
    "run", help="Bring every result of a project up to date, in the order in which the jobs need each other."
)
@click.argument("project", type=click.Path(path_type=Path), default=Path())
@click.option("--force", is_flag=True, help="Run every job, and overwrite whatever is at the outputs.")
@options.ACCEPT
@options.STRICT
@options.DRY_RUN
@options.JSON
@options.QUIET
@options.VERBOSE
def command(project: Path, force: bool, dry_run: bool, as_json: bool, quiet: bool, verbose: bool, **how: bool) -> int:
    """Run the jobs and print one line for each; return the exit code of the first that failed."""
    from metrocli.project import pipeline
    from metrocli.project.staleness import states
    from metrocli.project.steps import load_project

    steps = load_project(project, how["accept_doubtful"])
    console = Console(quiet or as_json, verbose)
    if dry_run:
        for state in states(steps, force, how["strict"]):
            console.print(f"{state.step.name}: {state_text(state)}")
        return 0
    reports = pipeline.run(steps, force, console.detail, lambda report: _print_report(report, console), how["strict"])
    if as_json:
        from metrocli.cli.summary import as_json as json_text

        echo(json_text({"jobs": [_summary(report) for report in reports]}))
    return pipeline.worst(report.exit_code for report in reports)


def _print_report(report: Report, console: Console) -> None:
    """Print the line of one job to stdout; failures, warnings and unmet criteria to stderr."""
    place = f" -> {report.step.job.output}" if report.action == "ran" else ""
    record = report.record if report.exit_code == NOT_MET else None
    unmet = f" ({_UNFIT[record.status]})" if record else ""
    reason = f" ({report.reason})" if report.reason else ""
    console.print(f"{report.step.name}: {report.action}{reason}{place}{unmet}")
    if report.error:
        echo(report.error, err=True)
    if report.done is not None:
        from metrocli.cli import terminal

        console.detail(terminal.result_text(report.done.result, report.done.record, report.done.path))
        for line in report.done.result.warnings:
            console.warning(f"{report.step.name}: {line}")
    if record is not None:
        from metrocli.cli import terminal

        terminal.print_unfit(record)


_UNFIT = {UNMET: "an acceptance criterion is not met", DOUBTFUL: "doubtful: do not use this result"}


def state_text(state: State) -> str:
    """Return whether a job would run, and why, in words."""
    if state.waits:
        return f"would not run: {state.reason}"
    if state.depends:
        return f"would run if a result that it uses changes: {state.reason}"
    return f"would run: {state.reason}" if state.reason else "up to date"


def _summary(report: Report) -> dict[str, Any]:
    from metrocli.cli import summary

    done = report.done
    facts = {"job": report.step.name, "action": report.action, "reason": report.reason, "exit_code": report.exit_code}
    more = summary.summary(done.result, done.record, done.path) if done else {"error": report.error}
    return facts | {"summary" if done else "error": more if done else report.error}
