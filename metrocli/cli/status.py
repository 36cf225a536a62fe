"""metrocli status: what is up to date, what is not, and why."""

from __future__ import annotations

from pathlib import Path

import click

from metrocli.cli import options
from metrocli.cli.console import Console, echo, echo_json
from metrocli.cli.run import nothing_to_do, state_data, state_text
from metrocli.project import PROJECT_FILE
from metrocli.project.running.memo import unmoved_jobs


@click.command("status", help="List what is up to date in a project, what is not, and why.")
@click.argument("project", type=click.Path(path_type=Path), default=Path())
@options.ACCEPT
@options.JSON
def command(project: Path, accept_doubtful: bool, as_json: bool) -> int:
    """Print one line for each job; return 0 whenever the project can be read."""
    place = project / PROJECT_FILE if project.is_dir() else project
    unmoved = unmoved_jobs(str(place)) if not accept_doubtful else None
    if unmoved is not None:
        return nothing_to_do(unmoved, place.parent, Console(as_json), as_json, dry=True)
    from metrocli.project.staleness import states
    from metrocli.project.steps import load_project

    current = list(states(load_project(project, accept_doubtful)))
    if as_json:
        echo_json({"jobs": [state_data(state) for state in current]})
        return 0
    for state in current:
        unfit = state.record if state.label and state.label.exit_code and not state.reason else None
        missed = [verdict.name for verdict in unfit.verdicts if not verdict.met] if unfit else []
        unmet = f" (not met: {', '.join(missed)})" if missed else ""
        doubt = f" (doubtful: {'; '.join(unfit.doubts)})" if unfit and unfit.doubts else ""
        echo(f"{state.step.name}: {state_text(state)}{unmet}{doubt}")
    return 0
