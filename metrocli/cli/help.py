"""The table of commands and the text of `metrocli --help`, without importing any command."""

from __future__ import annotations

from metrocli import __version__
from metrocli.tasks import KINDS

COMMANDS = {
    "init": "copy a sample project (list them without --sample)",
    "run": "bring every result of a project up to date",
    "status": "what is up to date, what is not, and why",
    "check": "validate a job or project without computing",
    "diagnose": "what the model of a job gets wrong, and why",
    "simulate": "the measurement that a job's model predicts",
    "plan": "what a planned measurement will determine, and a better one",
    "show": "a result on the terminal",
    "compare": "two results: differences, E_n, one test of all",
    "export": "a result in another format: CSV, compensation tables",
    "schema": "JSON schema of a job, for editors",
}
"""The commands that are not kinds of job; each is the module of its name in this package."""


def help_text() -> str:
    """Return what `metrocli --help` prints."""
    kinds = {name: kind.summary for name, kind in KINDS.items()}
    width = max(map(len, kinds | COMMANDS))
    return f"""Usage: metrocli COMMAND [ARGUMENTS]...    (more: metrocli COMMAND --help)

  Dimensional metrology: from readings to positions, poses and machine
  errors, with their uncertainty.

Kinds of job:
{_listed(kinds, width)}

Other commands:
{_listed(COMMANDS, width)}

Options:
  {"--version":{width}}  the version
  {"-h, --help":{width}}  this text
"""


def _listed(commands: dict[str, str], width: int) -> str:
    return "\n".join(f"  {name:{width}}  {summary}" for name, summary in commands.items())


def version_text() -> str:
    """Return what `metrocli --version` prints."""
    return f"metrocli {__version__}"
