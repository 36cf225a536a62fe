"""Completion, examples in the help, and remaining time."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from metrocli.cli.console import progress_text
from metrocli.cli.help import COMMANDS
from metrocli.tasks import KINDS

Metrocli = Callable[..., Any]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_a_shell(shell: str, metrocli: Metrocli) -> None:
    ran = metrocli("completion", shell)
    assert ran.code == 0 and f"_METROCLI_COMPLETE={shell}_complete" in ran.out


def test_an_unknown_shell_is_refused(metrocli: Metrocli) -> None:
    assert metrocli("completion", "tcsh").code == 2


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ("metrocli rep", {"report", "report-uncertainty"}),
        ("metrocli show --ta", {"--table"}),
        ("metrocli ", {"init", "align-part"}),
        ("metrocli plot x.h5 resid", {"residuals", "residuals-time"}),
        ("metrocli schema fit", {"fit-part"}),
        ("metrocli effects fit", {"fit-part"}),
        ("metrocli init gear --sample ge", {"gear-m3d3"}),
    ],
)
def test_words_are_completed(words: str, wanted: set[str]) -> None:
    """As the script of bash calls the program: without arguments, the words in its environment."""
    last = words.count(" ")
    environment = os.environ | {"_METROCLI_COMPLETE": "bash_complete", "COMP_WORDS": words, "COMP_CWORD": str(last)}
    code = "import sys; sys.argv = ['metrocli']; from metrocli.cli.main import main; main()"
    ran = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert wanted <= {line.partition(",")[2] for line in ran.stdout.splitlines()}


@pytest.mark.parametrize("name", [*COMMANDS, *KINDS])
def test_each_help_ends_with_an_example(name: str, metrocli: Metrocli) -> None:
    typed = metrocli(name, "--help").out.rstrip().splitlines()[-1]
    assert f"metrocli {name}" in typed


def test_remaining_time() -> None:
    assert progress_text(3, None, 9.0) == "3 parts"
    assert progress_text(0, 8, 2.0) == "0 of 8 parts"
    assert progress_text(2, 8, 10.0) == "2 of 8 parts, about 30 s left"
    assert progress_text(8, 8, 40.0) == "8 of 8 parts, 40 s"
    assert progress_text(0, None, 3.2) == "3 s"


def test_a_result_in_inches(job: Path, metrocli: Metrocli) -> None:
    metrocli("straight-line", job)
    shown = metrocli("show", "results/line.h5", "--units", "inch").out
    # 1.030 ± 0.084 mm; angles and counts stay
    plain = " ".join(shown.split())
    assert "offset 0.0406 ± 0.0033 in" in plain and "0.000980 ± 0.000045 rad" in plain
    assert "rms 0.002" in shown and "residual [in]" in shown and " mm\n" not in shown
    assert metrocli("show", "results/line.h5", "--units", "inch", "--json").code == 2
    assert metrocli("show", "results/line.h5", "--units", "mm").out == metrocli("show", "results/line.h5").out
