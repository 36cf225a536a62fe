"""Completion, examples in the help, and lengths in inches."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.shell_completion import BashComplete

from metrocli.cli.commands import commands
from metrocli.cli.help import COMMANDS
from metrocli.cli.look.inches import estimates_in, in_inches
from metrocli.result import Estimate, Result
from metrocli.table import Table
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


def test_a_result_in_inches(job: Path, metrocli: Metrocli) -> None:
    metrocli("straight-line", job)
    shown = metrocli("show", "results/line.h5", "--units", "inch").out
    # 1.030 ± 0.084 mm; angles and counts stay
    plain = " ".join(shown.split())
    assert "offset 0.0406 ± 0.0033 in" in plain and "0.000980 ± 0.000045 rad" in plain
    assert "rms 0.002" in shown and "residual [in]" in shown and " mm\n" not in shown
    assert metrocli("show", "results/line.h5", "--units", "inch", "--json").code == 2
    heads = [
        metrocli("show", "results/line.h5", "--table", "residuals", "--units", unit).out.splitlines()[:2]
        for unit in ("mm", "inch")
    ]
    name, column = "residual_mm", heads[0][0].split(",").index("residual_mm")
    assert heads[1][0].split(",")[column] == name.replace("_mm", "_in")
    in_mm, in_inches = (float(rows[1].split(",")[column]) for rows in heads)
    assert in_inches == pytest.approx(in_mm / 25.4, rel=1e-12) and in_mm != 0
    assert metrocli("report", "results/line.h5", "--units", "inch").code == 0
    page = Path("results/line.html").read_text(encoding="utf-8")
    assert '<td>offset</td><td class="n">0.0406</td><td class="n">0.0066</td><td>in</td>' in page
    assert "residual [in]" in page
    assert metrocli("show", "results/line.h5", "--units", "mm").out == metrocli("show", "results/line.h5").out


def test_an_answer_in_inches() -> None:
    found = estimates_in((Estimate("d", 25.4, 0.0254, "mm"), Estimate("turn", 1.0, 0.1, "rad")), "inch")
    assert [(one.value, one.std, one.unit) for one in found] == [(1.0, 0.001, "in"), (1.0, 0.1, "rad")]


def test_tables_are_completed_by_those_of_the_result(job: Path, metrocli: Metrocli) -> None:
    metrocli("straight-line", job)

    def offered(result: str, begun: str) -> list[str]:
        shell = BashComplete(commands, {}, "metrocli", "_METROCLI_COMPLETE")
        return [one.value for one in shell.get_completions(["show", result, "--table"], begun)]

    assert offered("results/line.h5", "res") == ["residuals"]
    assert "residuals" in offered("results/line.h5", "")
    assert offered("absent.h5", "") == offered(str(job), "") == []


def test_rows_with_a_unit_each_and_stated_uncertainties_in_inches() -> None:
    table = Table(
        {
            "error": np.array(["EXX", "EAX"]),
            "unit": np.array(["mm", "rad"]),
            "largest": np.array([0.0254, 2e-5]),
            "count": np.array([1, 2]),
            "at": np.array([25.4, 50.8]),
        },
        {"at": "mm"},
    )
    length = Estimate("l", 50.8, 0.0254, "mm", "length")
    found = in_inches(
        Result("kind", "", (length,), np.eye(1), {}, {"errors": table}, details={"l": {"U": 0.0508, "k": 2.0}})
    )
    errors = found.tables["errors"]
    assert errors.texts("unit") == ["in", "rad"] and errors.numbers("largest") == pytest.approx([1e-3, 2e-5])
    assert errors.columns["count"].tolist() == [1, 2] and errors.numbers("at") == pytest.approx([1, 2])
    assert found.expanded(found.estimates[0]) == pytest.approx((2e-3, 2.0))
