"""metrocli run: bring every result of a project up to date."""

from __future__ import annotations

import json
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrocli.cli import options
from metrocli.cli.console import Console, echo, echo_json
from metrocli.cli.shell.idle import up_to_date_lines
from metrocli.cli.shell.live_table import has_terminal, live_table, time_text
from metrocli.project import PROJECT_FILE
from metrocli.project.running import memo
from metrocli.record import DOUBTFUL, FAIL, NOT_MET, UNMET

if TYPE_CHECKING:
    from collections.abc import Sequence

    from metrocli.project.pipeline import Order, Report
    from metrocli.project.running.executor import Executor
    from metrocli.project.staleness import Staleness
    from metrocli.project.steps import ProjectStep


@click.command(
    "run", help="Bring every result of a project up to date, in the order in which the jobs need each other."
)
@click.argument("project", type=click.Path(path_type=Path), default=Path())
@click.option("--jobs", type=click.IntRange(1), default=1, metavar="N", help="Compute N jobs at once.")
@click.option("--only", multiple=True, metavar="JOB", help="Run this job and what it needs (repeatable).")
@click.option("--from", "start", metavar="JOB", help="Run this job and what needs its result.")
@options.SCHEDULER
@click.option("--wait", is_flag=True, help="Wait for another run on this project to end.")
@click.option(
    "--depfile", type=click.Path(path_type=Path), metavar="FILE", help="Write for Make what the results depend on."
)
@click.option("--force", is_flag=True, help="Run every job, and overwrite whatever is at the outputs.")
@options.ACCEPT
@options.STRICT
@options.DRY_RUN
@options.JSON
@options.QUIET
@options.VERBOSE
def command(project: Path, dry_run: bool, as_json: bool, quiet: bool, verbose: bool, **how: Any) -> int:
    """Run the jobs and print one line for each; return the worst of their exit codes."""
    console = Console(quiet or as_json, verbose)
    place = project / PROJECT_FILE if project.is_dir() else project
    plain = not any(how[option] for option in ("only", "start", "force", "depfile", "strict", "accept_doubtful"))
    begun = memo.now_ns()
    unmoved = memo.unmoved_jobs(str(place)) if plain else None
    if unmoved is not None:
        return nothing_to_do(unmoved, place.parent, console, as_json, dry_run)
    from metrocli.project import pipeline
    from metrocli.project.running import files as depfile
    from metrocli.project.running.files import locked
    from metrocli.project.staleness import states
    from metrocli.project.steps import load_project, project_file, selected

    file = project_file(project)
    with nullcontext() if dry_run else locked(file, how["wait"]):
        steps = selected(load_project(project, how["accept_doubtful"]), how["only"], how["start"])
        if how["depfile"] is not None:
            depfile.write(how["depfile"], file, steps, how["force"])
        order = pipeline.Order(how["force"], how["strict"])
        if dry_run:
            return _dry_run(list(states(steps, order.force, order.strict)), console, as_json)
        reports = _run(steps, order, console, how["jobs"], how["scheduler"])
        if how["only"]:
            depfile.renew(file, [report.step for report in reports if not report.exit_code])
    labels = {report.step.name: report.sealed for report in reports if not report.exit_code}
    if plain and len(labels) == len(steps):
        memo.remember(file, steps, begun, labels)
    code = pipeline.worst(report.exit_code for report in reports)
    if as_json:
        echo_json({"jobs": [_summary(report) for report in reports], "exit_code": code})
    return code


def nothing_to_do(jobs: Sequence[Sequence[str]], folder: Path, console: Console, as_json: bool, dry: bool) -> int:
    """Print that all jobs are up to date, as a run that looks at everything would."""
    if as_json:
        done = {"action": "up to date", "reason": "", "exit_code": 0}
        would = {"up_to_date": True, "would": "up to date", "reason": "", "status": "done"}
        listed = [
            {"job": name, "result": str(folder / result), **would} if dry
            else {"job": name, **done, "result": str(folder / result), "error": ""}
            for name, result in jobs
        ]  # fmt: skip
        echo(json.dumps({"jobs": listed} if dry else {"jobs": listed, "exit_code": 0}, indent=2, ensure_ascii=False))
    if not console.quiet and jobs:
        echo(up_to_date_lines(jobs), nl=False)
    return 0


def _run(steps: Sequence[ProjectStep], order: Order, console: Console, jobs: int, scheduler: str) -> list[Report]:
    """Run the jobs and print the line of each, on a terminal above a table of those in work; then the counts."""
    from metrocli.project import pipeline

    watched = has_terminal() and not (console.quiet or console.verbose)
    with live_table(len(steps), watched) as table, _executor(console, jobs, scheduler, steps) as executor:

        def finished(report: Report) -> None:
            with table.end(report.step.name, report.action):
                _print_report(report, console)

        reports = pipeline.run(steps, order, executor, finished, lambda step: table.begin(step.name))
    ran = any(report.action == pipeline.Action.RAN for report in reports)
    if any(report.exit_code for report in reports) or (watched and ran):
        _print_count(reports, console, f", in {time_text(table.seconds)}" if watched else "")
    return reports


def _executor(
    console: Console, jobs: int, scheduler: str, steps: Sequence[ProjectStep]
) -> AbstractContextManager[Executor]:
    from metrocli.project.running.executor import InThisProcess, processes

    if scheduler:
        from metrocli.project.running.cluster import on_cluster

        return on_cluster(scheduler, [step.job for step in steps])
    return nullcontext(InThisProcess(console)) if jobs == 1 else processes(jobs)


def _dry_run(states: Sequence[Staleness], console: Console, as_json: bool) -> int:
    if as_json:
        echo_json({"jobs": [state_data(state) for state in states]})
    for state in states:
        console.print(f"{state.step.name}: {state_text(state)}")
    return 0


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


def _print_count(reports: Sequence[Report], console: Console, end: str) -> None:
    """Print to stderr how many jobs did what, unless quiet."""
    if console.quiet:
        return
    counts: dict[str, int] = {}
    for report in reports:
        unfit = report.exit_code == NOT_MET and report.action != "not run"
        failed = unfit and report.record is not None and report.record.status == FAIL
        what = "out of tolerance" if failed else "not fit for use" if unfit else str(report.action)
        counts[what] = counts.get(what, 0) + 1
    what_they_did = ", ".join(f"{count} {what}" for what, count in counts.items())
    echo(f"{len(reports)} job{'s' if len(reports) > 1 else ''}: {what_they_did}{end}", err=True)


_UNFIT = {
    FAIL: "fail: out of tolerance",
    UNMET: "an acceptance criterion is not met",
    DOUBTFUL: "doubtful: do not use this result",
}


def state_text(state: Staleness) -> str:
    """Return whether a job would run, and why, in words."""
    if state.waits:
        return f"would not run: {state.reason}"
    if state.depends:
        return f"would run if a result that it uses changes: {state.reason}"
    return f"would run: {state.reason}" if state.reason else "up to date"


def state_data(state: Staleness) -> dict[str, Any]:
    """Return the same for --json."""
    word = "waits" if state.waits else "depends" if state.depends else "runs" if state.reason else "up to date"
    return {
        "job": state.step.name,
        "result": str(state.step.job.output),
        "up_to_date": not state.reason,
        "would": word,
        "reason": state.reason,
        "status": state.label.status if state.label else None,
    }


def _summary(report: Report) -> dict[str, Any]:
    from metrocli.cli import summary

    done = report.done
    facts = {"job": report.step.name, "action": report.action, "reason": report.reason, "exit_code": report.exit_code}
    facts |= {"result": str(report.step.job.output)}
    if done is None:
        return facts | {"error": report.error}
    return facts | {"summary": summary.summary(done.result, done.record, done.path)}
