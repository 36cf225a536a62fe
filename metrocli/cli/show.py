"""metrocli show: a result on the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from metrocli.cli import options
from metrocli.cli.console import echo
from metrocli.cli.look.opened import print_reasons
from metrocli.cli.shell.choices import tables
from metrocli.errors import UsageError
from metrocli.tasks import KINDS
from metrocli.words import suggestion

if TYPE_CHECKING:
    from metrocli.result import Result

QUESTIONS = {question.name: question for kind in KINDS.values() for question in kind.result_questions}


@click.command("show", help="Print a result.")
@click.argument("result", type=click.Path(path_type=Path), metavar="RESULT.h5")
@click.option("--table", "name", metavar="NAME", help="Print one whole table as CSV.", shell_complete=tables)
@options.all_of(*map(options.asking, QUESTIONS.values()))
@options.UNITS
@options.JSON
def command(result: Path, name: str | None, units: str, as_json: bool, **asked: tuple[str, ...] | None) -> int:
    """Print a result as its job did, or one of its tables, or the answer to a question of its kind."""
    from metrocli.cli import summary, terminal
    from metrocli.cli.look.inches import INCHES, in_units
    from metrocli.formats import csv, hdf5

    stored, record = hdf5.read(result)
    wanted = [f"--{option}" for option in QUESTIONS if asked[option] is not None] + ["--table"] * (name is not None)
    if len(wanted) > 1:
        raise UsageError(f"{' and '.join(wanted)}: one question at a time")
    if units == INCHES and as_json:
        raise UsageError("--units inch is for people and tables; --json is in mm")
    stated = in_units(stored, units)
    if wanted:
        print_reasons(result, record)
    if name is not None:
        if name not in stored.tables:
            raise UsageError(f"{result} has no table '{name}'; {suggestion(name, stored.tables)}")
        table = stated.tables[name]
        echo(summary.json_of_table(table) if as_json else csv.to_text(table), nl=as_json, as_is=True)
        return 0
    question = next((option for option in QUESTIONS if asked[option] is not None), None)
    if question is not None:
        echo(_answer(stored, question, asked[question] or (), units, as_json))
        return 0
    if as_json:
        echo(summary.json_of(stored, record, result))
        return 0
    echo(terminal.result_text(stated, record, result))
    echo(f"tables: {', '.join(stored.tables) or 'none'}")
    for line in stored.warnings:
        echo(f"warning: {line}", err=True)
    return 0


def _answer(result: Result, question: str, values: tuple[str, ...], units: str, as_json: bool) -> str:
    """Return the answer to a question about a result as text; raise UsageError if its kind has no such question."""
    from metrocli.cli import summary, terminal
    from metrocli.cli.look.inches import estimates_in

    answering = [kind.name for kind in KINDS.values() if question in {option.name for option in kind.result_questions}]
    if result.kind not in answering:
        raise UsageError(f"--{question} is for results of {' and '.join(answering)}; this is a result of {result.kind}")
    estimates = KINDS[result.kind].task().result_answers[question](result, values)
    if not as_json:
        return terminal.estimates_text(estimates_in(estimates, units))
    entries = [{"name": estimate.name, **summary.of_estimate(estimate)} for estimate in estimates]
    return summary.as_json(entries if len(entries) > 1 else entries[0])
