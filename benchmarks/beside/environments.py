"""Environments of other programs, each in a folder of its own under build/peers, where it stays for the next run."""

from __future__ import annotations

import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

HERE = Path(__file__).parents[2] / "build" / "peers"
PATIENCE_S = 600
"""Longest time of an installation [s]"""


@cache
def python_of(package: str) -> Path | None:
    """Return the interpreter of an environment with a package from PyPI; None if it cannot be had."""
    folder, python = HERE / package, HERE / package / "bin" / "python"
    done = folder / "installed"
    if not done.is_file():
        try:
            subprocess.run([sys.executable, "-m", "venv", "--clear", str(folder)], check=True, capture_output=True)
            call = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", package]
            subprocess.run(call, check=True, capture_output=True, timeout=PATIENCE_S)
        except (subprocess.SubprocessError, OSError):
            return None
        done.touch()
    return python


def environment_of(package: str) -> Path | None:
    """Return the interpreter of an environment that exists; None where it does not."""
    python = HERE / package / "bin" / "python"
    return python if python.is_file() else None


@cache
def python_with(module: str) -> Path | None:
    """Return a Python of the machine that has a module, such as one that the system's packages have installed."""
    for python in dict.fromkeys(filter(None, (shutil.which("python3"), "/usr/bin/python3"))):
        if (
            Path(python).is_file()
            and not subprocess.run([python, "-c", f"import {module}"], capture_output=True).returncode
        ):
            return Path(python)
    return None


def program_of(name: str) -> str | None:
    """Return a program that the machine has, or that a package of its name on PyPI has; None if it cannot be had."""
    there = shutil.which(name)
    if there is not None or name == "make":
        return there
    python = python_of(name)
    return None if python is None else shutil.which(name, path=str(python.parent))


def version_of(package: str, python: Path | None = None) -> str:
    """Return the version of a package, in an environment or in this one."""
    call = f"from importlib.metadata import version; print(version({package!r}))"
    done = subprocess.run([str(python or sys.executable), "-c", call], capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"
