"""Help and version import nothing heavy; the table of commands is right."""

from __future__ import annotations

import resource
import subprocess
import sys

import pytest

from metrocli import tasks
from metrocli.cli import main

HEAVY = ("numpy", "scipy", "cv2", "h5py", "yaml", "json")
MOST_CPU_S = 0.08
IMPORTED = """
import sys
from metrocli.cli.main import run
code = run(sys.argv[1:])
print([name for name in {heavy} if name in sys.modules], file=sys.stderr)
sys.exit(code)
"""


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["align-part", "--help"], ["run", "--help"], ["nonsense"]])
def test_nothing_heavy_is_imported(arguments: list[str]) -> None:
    script = IMPORTED.format(heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=False)
    assert done.stderr.splitlines()[-1] == "[]"
    assert done.returncode == (2 if arguments == ["nonsense"] else 0)


def test_help_costs_little() -> None:
    def cost(*arguments: str) -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *arguments], capture_output=True, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    program = "from metrocli.cli.main import run; run(['--help'])"
    own = [cost("-c", program) - cost("-c", "import click") for _ in range(5)]
    assert min(own) < MOST_CPU_S / 4, "beyond click itself, help takes a quarter of what all of it may take"


def test_help_names_every_command() -> None:
    done = subprocess.run([sys.executable, "-m", "metrocli", "--help"], capture_output=True, text=True, check=True)
    for name in (*tasks.KINDS, *main.COMMANDS):
        assert name in done.stdout


@pytest.mark.parametrize("name", main.COMMANDS)
def test_each_command_is_there_and_says_what_help_says(name: str) -> None:
    command = main.commands.get_command(None, name)  # type: ignore[arg-type]
    assert command is not None
    assert command.name == name
    assert command.help


@pytest.mark.parametrize("kind", tasks.KINDS)
def test_each_kind_is_as_the_table_says(kind: str) -> None:
    module = tasks.load(kind)
    assert (module.KIND, module.SUMMARY) == (kind, tasks.KINDS[kind].summary)
    for question in tasks.KINDS[kind].answers:
        assert callable(getattr(module, question))
