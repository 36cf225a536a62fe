"""What the results of a project depend on, in the language of Make."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

from metrocli.errors import Fault, InputError
from metrocli.formats.own_files import write_all
from metrocli.project.steps import Step
from metrocli.settings import has_wildcards

_SPECIAL = re.compile(r"(\\*)([ #:*?\[])")
"""What Make takes as itself behind a backslash, and the backslashes before it, which then count twice"""
_FOREIGN = re.compile(r"[%=;|\x00-\x1f\x7f]|\\$")
"""What Make takes as itself nowhere"""


def write(path: Path, project_file: Path, steps: Sequence[Step], force: bool = False) -> None:
    """Write a rule without commands for each result: it depends on its job, its inputs and the project file.

    A folder in which a pattern of images is matched counts as an input. Paths are relative to the working folder, as
    Make needs them, if they lie below it. Raises InputError with each name that Make cannot read, and if a file is
    there that metrocli did not write, unless forced.
    """
    faults: list[Fault] = []
    rules = []
    for step in steps:
        folders = (one.parent for item in step.job.inputs for one in item.patterns if not has_wildcards(one.parent))
        searched = (step.job.folder / one for one in folders)
        needed = (step.job.file, project_file, *step.job.stated_in, *step.job.files, *searched)
        words = dict.fromkeys(_word(one, faults) for one in needed)
        rules.append(f"{_word(step.job.output, faults)}: {' '.join(words)}\n")
    if faults:
        raise InputError(list(dict.fromkeys(faults)))
    list(write_all({path: "".join(rules).encode()}, force))


def _word(path: Path, faults: list[Fault]) -> str:
    text = os.path.normpath(path)
    if _FOREIGN.search(text):
        faults.append(Fault("Make cannot read this name", text, hint="rename it without %=;|"))
    return _SPECIAL.sub(r"\1\1\\\2", text).replace("$", "$$")
