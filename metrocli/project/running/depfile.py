"""What the results of a project depend on, in the language of Make."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

from metrocli.errors import Fault, InputError
from metrocli.formats.own_files import write_all
from metrocli.project.steps import Step

_SPECIAL = re.compile(r"(\\*)([ #:*?\[])")
"""What Make takes as itself behind a backslash, and the backslashes before it, which then count twice"""
_FOREIGN = re.compile(r"[%=;|\x00-\x1f\x7f]|\\$")
"""What Make takes as itself nowhere"""


def write(path: Path, project_file: Path, steps: Sequence[Step], force: bool = False) -> None:
    """Write a rule without commands for each result: it depends on its job, its inputs and the project file.

    A folder in which a pattern of images is matched counts as an input. What decides which files these are is in a rule
    for the file itself, and each of them in a rule of its own, so that Make goes on if it is gone. Paths are relative
    to the working folder, as Make needs them, if they lie below it. Raises InputError with each name that Make cannot
    read, and if a file is there that metrocli did not write, unless forced.
    """
    faults: list[Fault] = []
    rules: dict[str, dict[str, None]] = {}
    deciding: dict[str, None] = {}
    for step in steps:
        searched = (folder for item in step.job.inputs for folder in item.searched)
        stated = dict.fromkeys(_word(one, faults) for one in (step.job.file, project_file, *step.job.stated_in))
        folders = dict.fromkeys(_word(one, faults) for one in searched)
        needed = stated | dict.fromkeys(_word(one, faults) for one in step.job.files) | folders
        rules[_word(step.job.output, faults)] = needed
        deciding |= stated | folders
    rules |= {_word(path, faults): deciding} | {name: {} for name in deciding}
    if faults:
        raise InputError(list(dict.fromkeys(faults)))
    text = "".join(f"{' '.join((f'{name}:', *needed))}\n" for name, needed in rules.items())
    list(write_all({path: text.encode()}, force))
    # a folder of images that holds this file has its time, and must not be younger
    os.utime(path)


def _word(path: Path, faults: list[Fault]) -> str:
    text = os.path.normpath(path)
    if _FOREIGN.search(text):
        faults.append(Fault("Make cannot read this name", text, hint="rename it without %=;|"))
    return _SPECIAL.sub(r"\1\1\\\2", text).replace("$", "$$")
