"""metrocli completion: the script by which a shell completes commands, options and files."""

from __future__ import annotations

import click

SHELLS = ("bash", "zsh", "fish")


@click.command("completion", help="Print the script that completes commands, options and files in a shell.")
@click.argument("shell", type=click.Choice(SHELLS))
@click.pass_context
def command(context: click.Context, shell: str) -> int:
    """Print the script, which asks `metrocli` itself for the words to choose from."""
    from click.shell_completion import get_completion_class

    completion = get_completion_class(shell)
    assert completion is not None, shell
    click.echo(completion(context.find_root().command, {}, "metrocli", "_METROCLI_COMPLETE").source())
    return 0
