"""The Makefile and the CI jobs of the docs work as they stand."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from places import DOCS, SAMPLES
from report.test_in_browser import shortened

BLOCKS = re.findall(r"^```(make|yaml)\n(.*?)^```$", (DOCS / "automation.md").read_text(), re.DOTALL | re.MULTILINE)


@pytest.fixture
def project(tmp_path: Path) -> Path:
    shutil.copytree(SAMPLES / "gear-m3d3", tmp_path / "p", ignore=shutil.ignore_patterns("results"))
    shortened(tmp_path / "p")
    return tmp_path / "p"


def shell(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    place = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    return subprocess.run(command, shell=True, cwd=folder, env=place, capture_output=True, text=True, check=False)


def test_the_makefile_makes_what_changed(project: Path) -> None:
    (project / "Makefile").write_text(next(text for kind, text in BLOCKS if kind == "make"))
    first = shell("make", project)
    assert first.returncode == 0, first.stderr
    assert (project / "page.txt").read_text().startswith("multilaterate: Large gear, tip 3")
    assert "Nothing to be done" in shell("make", project).stdout
    job = project / "jobs/tip3.yaml"
    job.write_text(job.read_text().replace("tip 3", "tip three"))
    assert shell("make", project).returncode == 0
    assert "tip three" in (project / "page.txt").read_text()


def commands(value: Any) -> Iterator[str]:
    """The commands of a CI job: items under `script`, and values of `run`."""
    if isinstance(value, dict):
        for key, below in value.items():
            if key == "run":
                yield below
            elif key == "script":
                yield from below
            else:
                yield from commands(below)
    elif isinstance(value, list):
        for one in value:
            yield from commands(one)


@pytest.mark.slow
def test_the_commands_of_ci_jobs_run(project: Path) -> None:
    jobs = [list(commands(yaml.safe_load(text))) for kind, text in BLOCKS if kind == "yaml"]
    wanted = [[one for one in job if one.startswith("metrocli")] for job in jobs]
    assert [len(job) for job in wanted] == [2, 2]
    for command in dict.fromkeys(one for job in wanted for one in job):
        done = shell(command, project)
        assert done.returncode == 0, done.stderr
    assert (project / "results.json").read_text().startswith("{")
    assert (project / "results/tip3.h5").exists()
