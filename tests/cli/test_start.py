"""Help and version import nothing heavy; the table of commands is right."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from benchmarks import command_speed
from benchmarks.projects import small_jobs
from metrocli import tasks
from metrocli.cli import commands, help

HEAVY = ("numpy", "scipy", "cv2", "h5py", "yaml")
UNUSED = ("zipfile", "concurrent.futures")
"""Loaded by jobs in chunks only"""
IMPORTED = """
import sys
from metrocli.cli.commands import run
code = run(sys.argv[1:])
print([name for name in {heavy} if name in sys.modules], file=sys.stderr)
sys.exit(code)
"""


@pytest.mark.parametrize(
    "arguments", [["--help"], ["--version"], ["align-part", "--help"], ["run", "--help"], ["nonsense"]]
)
def test_nothing_heavy_is_imported(arguments: list[str]) -> None:
    script = IMPORTED.format(heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=False)
    assert done.stderr.splitlines()[-1] == "[]"
    assert done.returncode == (2 if arguments == ["nonsense"] else 0)


def test_a_network_of_lengths_loads_no_scipy(tmp_path: Path) -> None:
    script = IMPORTED.format(heavy=("scipy", "numpy.ma", "numpy.random", *UNUSED))
    arguments = ["multilaterate", str(command_speed.network(tmp_path / "network", 100)), "--quiet"]
    done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=False)
    assert (done.stderr.splitlines()[-1], done.returncode) == ("[]", 0)


@pytest.mark.parametrize(
    "name", [pytest.param("calibrate-machine, lengths", marks=pytest.mark.slow), "calibrate-machine, standstill"]
)
def test_a_small_calibration_of_a_machine_loads_no_scipy(
    name: str, tmp_path: Path, metrocli: Callable[..., Any]
) -> None:
    job = tmp_path / "job.yaml"
    job.write_text(small_jobs.SIMULATED[name])
    assert metrocli("simulate", job, "--seed", 1, "--out", tmp_path / "made").code == 0
    for file in (tmp_path / "made").glob("*.csv"):
        file.rename(tmp_path / file.name)
    script = IMPORTED.format(heavy=("scipy", *UNUSED))
    arguments = ["calibrate-machine", str(job), "--quiet"]
    done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=False)
    assert (done.stderr.splitlines()[-1], done.returncode) == ("[]", 0)


def test_memory_is_not_searched_for_cycles_at_the_end() -> None:
    script = """
import atexit, gc, sys
from metrocli.cli.main import main
atexit.register(lambda: print(len(gc.get_objects()) < gc.get_freeze_count(), file=sys.stderr))
sys.argv = ["metrocli", "schema", "selfcal-grid"]
main()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stderr.splitlines()[-1] == "True"


def test_help_names_every_command() -> None:
    done = subprocess.run([sys.executable, "-m", "metrocli", "--help"], capture_output=True, text=True, check=True)
    for name in (*tasks.KINDS, *help.COMMANDS):
        assert name in done.stdout


@pytest.mark.parametrize("name", help.COMMANDS)
def test_each_command_is_there_and_says_what_help_says(name: str) -> None:
    command = commands.commands.get_command(None, name)  # type: ignore[arg-type]
    assert command is not None
    assert command.name == name
    assert command.help


@pytest.mark.parametrize("arguments", [[], ["-h"], ["--help"], ["--version"]])
def test_the_front_door_says_what_the_commands_say(arguments: list[str]) -> None:
    texts = [
        subprocess.run([sys.executable, *how, *arguments], capture_output=True, text=True, check=False).stdout
        for how in (["-m", "metrocli"], ["-c", "import sys; from metrocli.cli.commands import run; run(sys.argv[1:])"])
    ]
    assert texts[0]
    assert texts[1] == texts[0] or not arguments


@pytest.mark.parametrize(("given", "used"), [({}, "1"), ({"OMP_NUM_THREADS": "3"}, "3")])
def test_matrix_products_take_one_thread_unless_told(given: dict[str, str], used: str) -> None:
    script = """
import atexit, os, sys
from metrocli.cli.main import main
atexit.register(lambda: print(os.environ["OMP_NUM_THREADS"], file=sys.stderr))
sys.argv = ["metrocli", "schema", "selfcal-grid"]
main()
"""
    environment = {key: value for key, value in os.environ.items() if key != "OMP_NUM_THREADS"} | given
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    assert done.stderr.splitlines()[-1] == used
