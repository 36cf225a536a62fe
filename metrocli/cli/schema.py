"""metrocli schema: JSON schema of a job, for editors."""

from __future__ import annotations

import click

from metrocli.cli.console import echo_json
from metrocli.cli.shell.choices import kinds, offering
from metrocli.errors import UsageError
from metrocli.tasks import KINDS
from metrocli.words import suggestion


@click.command("schema", help="Print the JSON schema (2020-12) of a job of one kind, or of any kind.")
@click.argument("kind", required=False, metavar="[KIND]", shell_complete=offering(kinds))
def command(kind: str | None) -> int:
    """Print the schema of one kind, or one that accepts every kind."""
    from metrocli.project.job import schema

    if kind is not None and kind not in KINDS:
        raise UsageError(f"no kind of job '{kind}'; {suggestion(kind, KINDS)}")
    dialect = "https://json-schema.org/draft/2020-12/schema"
    echo_json(schema(kind) if kind else {"$schema": dialect, "anyOf": [schema(name) for name in KINDS]})
    return 0
