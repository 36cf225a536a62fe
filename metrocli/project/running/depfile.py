"""What the results of a project depend on, in the language of Make."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from metrocli.formats.own_files import write_all
from metrocli.project.steps import Step


def write(path: Path, project_file: Path, steps: Sequence[Step], force: bool = False) -> None:
    """Write a rule without commands for each result: it depends on its job, its inputs and the project file.

    Paths are relative to the working folder, as Make needs them, if they lie below it. Raises InputError if a file is
    there that metrocli did not write, unless forced.
    """
    rules = []
    for step in steps:
        needed = " ".join(_word(one) for one in (step.job.file, project_file, *step.job.files))
        rules.append(f"{_word(step.job.output)}: {needed}\n")
    list(write_all({path: "".join(rules).encode()}, force))


def _word(path: Path) -> str:
    text = os.path.normpath(path)
    return text.replace("$", "$$").replace("#", "\\#").replace(" ", "\\ ")
