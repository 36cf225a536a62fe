"""`check` finds before computing what `run` would find."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from places import ROOT

from metrocli.project import runner

SAMPLES = sorted(path.parent.name for path in (ROOT / "sample_projects").glob("*/metrocli.yaml"))


@pytest.mark.alike
@pytest.mark.parametrize("name", SAMPLES)
def test_a_project_is_checked_before_its_first_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Callable[..., Any]
) -> None:
    assert metrocli("init", tmp_path / "new", "--sample", name).code == 0
    monkeypatch.chdir(tmp_path / "new")
    done = metrocli("check", ".")
    assert done.code == 0, done.err
    assert not Path("results").exists()


FAULTS: dict[str, tuple[str, str, str, str, str]] = {
    "size of the images": ("board-camera", "jobs/calibrate.yaml", "[640, 480]", "[640, 400]",
                           "jobs/calibrate.yaml: error: the images are 640 x 480 px"),
    "a view without its ball": ("ball-cube", "data/views.csv", "\n1,-2,-2,-2,", "\n1,-3,-2,-2,", "data/views.csv:"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_of_files_is_found_without_computing(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Callable[..., Any]
) -> None:
    sample, file, old, new, words = FAULTS[name]
    metrocli("init", tmp_path / "new", "--sample", sample)
    monkeypatch.chdir(tmp_path / "new")
    text = Path(file).read_text()
    assert old in text
    Path(file).write_text(text.replace(old, new, 1))
    found, ran = metrocli("check", "."), metrocli("run", ".")
    assert (found.code, ran.code) == (3, 3), (found.err, ran.err)
    assert words in found.err and words in ran.err, (found.err, ran.err)


@pytest.mark.parametrize("command", ["check", "straight-line", "run"])
def test_an_output_that_cannot_be_written_is_found_without_computing(
    command: str, job: Path, metrocli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*arguments: object) -> None:
        raise AssertionError("it was computed")

    monkeypatch.setattr(runner, "_sound", never)
    Path("metrocli.yaml").write_text("jobs: [line.yaml]\n")
    job.write_text(job.read_text() + "output: readings.csv/results/line.h5\n")
    ran = metrocli(command, "." if command == "run" else job)
    assert ran.code == 3
    assert "readings.csv/results/line.h5: error: cannot be written: " in ran.err
    assert "readings.csv is a file, not a folder" in ran.err

    job.write_text(job.read_text().replace("readings.csv/results", "results"))
    monkeypatch.setattr(
        os, "access", lambda path, mode: not mode & os.W_OK
    )  # which a test that root runs cannot have otherwise
    ran = metrocli(command, "." if command == "run" else job)
    assert (ran.code, "cannot be written: no right to write into" in ran.err) == (3, True)


def test_a_name_that_the_encoding_of_the_shell_lacks_is_refused_in_words(job: Path) -> None:
    Path("metrocli.yaml").write_text("jobs: [größe.yaml]\n", encoding="utf-8")
    shell = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "metrocli", "check", ".", "--json"]
    done = subprocess.run(command, capture_output=True, check=False, env=os.environ | shell)
    (fault,) = json.loads(done.stdout.decode("utf-8", "replace"))["errors"]
    assert (done.returncode, "cannot be a file name in ascii" in fault["message"]) == (3, True)
    assert b"Traceback" not in done.stderr and b"PYTHONUTF8=1" in done.stderr
