"""metrocli status: what is up to date, what is not, and why."""

from __future__ import annotations

from pathlib import Path

import click

from metrocli.cli import options


@click.command("status", help="List what is up to date in a project, what is not, and why.")
@click.argument("project", type=click.Path(path_type=Path), default=Path())
@options.JSON
def command(project: Path, as_json: bool) -> int:
    """Print one line for each job; return 0 whenever the project can be read."""
    from metrocli.project.pipeline import load_project, states

    found = list(states(load_project(project)))
    if as_json:
        from metrocli.cli.summary import as_json as json_text

        rows = [{"job": s.step.name, "up_to_date": not s.reason, "reason": s.reason} for s in found]
        click.echo(json_text({"jobs": rows}))
        return 0
    for state in found:
        missed = [verdict.name for verdict in state.record.verdicts if not verdict.met] if state.record else []
        unmet = f" (not met: {', '.join(missed)})" if missed else ""
        shown = f"would run: {state.reason}" if state.reason else f"up to date{unmet}"
        click.echo(f"{state.step.name}: {shown}")
    return 0
