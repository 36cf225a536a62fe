"""Closed and full streams, and a working folder that is gone, give a sentence and an exit code, never a traceback."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FULL = Path("/dev/full")
COMMAND = f"{sys.executable} -m metrocli"


def shell(line: str, folder: Path) -> tuple[int, str]:
    """The exit code of a line for the shell, and what reaches stdout and stderr."""
    ran = subprocess.run(["sh", "-c", line], cwd=folder, capture_output=True, text=True, check=False, timeout=60)
    return ran.returncode, ran.stdout + ran.stderr


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize(
    "arguments",
    [
        *(pytest.param(one, marks=pytest.mark.slow) for one in ("--version", "check --help", "schema multilaterate")),
        "--help",
        "show absent.h5 --json",
    ],
)
def test_a_full_stdout_ends_with_3(arguments: str, tmp_path: Path) -> None:
    code, said = shell(f"{COMMAND} {arguments} > /dev/full", tmp_path)
    assert code == 3 and "Traceback" not in said and "Exception ignored" not in said
    assert "the output cannot be written" in said or "no such file" in said


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize("stream", ["2>&-", pytest.param("2>/dev/full", marks=pytest.mark.slow), ">&- 2>&-"])
def test_messages_that_nobody_can_read_change_no_exit_code(stream: str, tmp_path: Path) -> None:
    assert shell(f"{COMMAND} show absent.h5 {stream}", tmp_path) == (3, "")
    assert shell(f"{COMMAND} --no-such-option {stream}", tmp_path) == (2, "")


def test_a_closed_stdout_is_no_file(tmp_path: Path) -> None:
    assert shell(f"{COMMAND} --version >&-", tmp_path) == (0, "")


@pytest.mark.parametrize("arguments", ["status", "check job.yaml", "run"])
def test_a_working_folder_that_is_gone(arguments: str, tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    code, said = shell(f"rmdir {gone}; {COMMAND} {arguments}", gone)
    assert code == 3 and "the working folder no longer exists" in said and "Traceback" not in said
    assert os.getcwd()
