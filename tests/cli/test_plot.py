"""metrocli plot: names of the figures, and one figure as a file."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

Metrocli = Callable[..., Any]


def test_names_and_a_file(job: Path, metrocli: Metrocli) -> None:
    metrocli("straight-line", job)
    listed = metrocli("plot", "results/line.h5")
    assert listed.code == 0
    names = ["residuals", "normal-plot", "correlation", "lineage"]
    assert [line.split()[0] for line in listed.out.splitlines()] == names
    assert metrocli("plot", "results/line.h5", "correlation").out == "results/line.correlation.svg\n"
    assert Path("results/line.correlation.svg").read_text().startswith("<?xml")
    assert metrocli("plot", "results/line.h5", "residuals", "--save", "r.pdf", "--dark", "--quiet").out == ""
    assert Path("r.pdf").read_bytes().startswith(b"%PDF")


def test_faults(job: Path, metrocli: Metrocli) -> None:
    metrocli("straight-line", job)
    ran = metrocli("plot", "results/line.h5", "residual")
    assert (ran.code, ran.err) == (
        2,
        "error: this result of straight-line has no figure 'residual'; did you mean 'residuals'?\n",
    )
    assert metrocli("plot", "results/line.h5", "residuals", "--save", "r.jpg").code == 2
    assert metrocli("plot", "results/line.h5", "--save", "r.svg").code == 2
    assert metrocli("plot", "line.yaml").code == 3
    assert not Path("r.jpg").exists()


def test_listing_the_figures_loads_no_matplotlib_before_it_is_needed(job: Path) -> None:
    code = "import sys; from metrocli import plots; from metrocli.cli.look import plot; assert 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
