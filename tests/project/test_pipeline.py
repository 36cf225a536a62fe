"""Projects: order, what is stale and why, and what a failure stops."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

HEAD = "metrocli: 1\njob: straight-line\nnoise: 0.1 mm\n"
FIRST = HEAD + "inputs: {readings: ../readings.csv}\noutput: ../results/first.h5\n"
SECOND = HEAD + "inputs: {readings: ../readings.csv, known: ../results/first.h5}\noutput: ../results/second.h5\n"
THIRD = HEAD + "inputs: {readings: ../more.csv}\noutput: ../results/third.h5\n"
LIST = "project: three lines\njobs: [jobs/second.yaml, jobs/first.yaml, jobs/third.yaml]\n"


@pytest.fixture
def project(job: Path) -> Path:
    """A project of three jobs, the second listed before the first whose result it needs."""
    for name, text in (("first", FIRST), ("second", SECOND), ("third", THIRD)):
        Path("jobs").mkdir(exist_ok=True)
        Path(f"jobs/{name}.yaml").write_text(text)
    shutil.copy("readings.csv", "more.csv")
    Path("metrocli.yaml").write_text(LIST)
    return Path()


def actions(ran: Any) -> dict[str, str]:
    """Return by job what a run or status says of it."""
    pairs = (line.split(": ", 1) for line in ran.out.splitlines())
    return {Path(name).stem: said for name, said in pairs}


def kinds(ran: Any) -> str:
    """Return the jobs that ran, as letters."""
    return "".join(sorted(name[0] for name, said in actions(ran).items() if said.startswith("ran")))


def test_a_run_in_the_order_of_needs_and_then_nothing(project: Path, metrocli: Callable[..., Any]) -> None:
    ran = metrocli("run")
    assert ran.code == 0
    assert ran.out.splitlines() == [
        "jobs/first.yaml: ran (there is no result yet) -> results/first.h5",
        "jobs/second.yaml: ran (there is no result yet) -> results/second.h5",
        "jobs/third.yaml: ran (there is no result yet) -> results/third.h5",
    ]
    assert actions(metrocli("run")) == dict.fromkeys(("first", "second", "third"), "up to date")
    assert metrocli("status").code == 0


def test_a_dry_run_says_what_the_run_does(project: Path, metrocli: Callable[..., Any]) -> None:
    dry = actions(metrocli("run", "--dry-run"))
    assert not Path("results").exists()
    assert dry == actions(metrocli("status"))
    real = actions(metrocli("run"))
    assert {name: said.replace("would run: ", "") for name, said in dry.items()} == {
        name: said.split("(")[1].split(")")[0] for name, said in real.items()
    }


CHANGES: dict[str, tuple[Callable[[], object], str, str]] = {
    "touch": (lambda: Path("readings.csv").touch(), "", ""),
    "same content again": (lambda: Path("readings.csv").write_bytes(Path("readings.csv").read_bytes()), "", ""),
    "input": (lambda: Path("more.csv").write_text("point,x_mm,y_mm\na,1,2\nb,2,3\nc,4,5\n"), "t", "input ../more.csv changed (61 bytes, sha256 "),
    "job": (lambda: Path("jobs/third.yaml").write_text(THIRD.replace("0.1", "0.2")), "t", "noise: 0.1 mm -> 0.2 mm"),
    "upstream job": (lambda: Path("jobs/first.yaml").write_text(FIRST + "title: x\n"), "fs", "title: x is new"),
    "output gone": (lambda: Path("results/first.h5").unlink(), "f", "there is no result yet"),
    "output truncated": (
        lambda: Path("results/third.h5").write_bytes(Path("results/third.h5").read_bytes()[:900]), "t", "damaged or was edited"),
    "output empty": (lambda: Path("results/third.h5").write_bytes(b""), "t", "damaged or was edited"),
}  # fmt: skip


@pytest.mark.parametrize("name", CHANGES)
def test_what_changed_runs_again_and_nothing_else(name: str, project: Path, metrocli: Callable[..., Any]) -> None:
    change, expected, reason = CHANGES[name]
    metrocli("run")
    change()
    status = metrocli("status").out
    assert reason in status
    assert status.count("would run:") == len(expected) - (name == "upstream job")
    assert kinds(metrocli("run")) == expected
    assert kinds(metrocli("run")) == ""


def test_another_version_runs_everything(
    project: Path, metrocli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    metrocli("run")
    for module in ("fingerprint", "running.memo"):
        monkeypatch.setattr(f"metrocli.project.{module}.__version__", "9.9")
    assert "the result was made by metrocli 0" in metrocli("status").out


def test_a_deleted_input_is_an_error_and_never_up_to_date(project: Path, metrocli: Callable[..., Any]) -> None:
    metrocli("run")
    Path("readings.csv").unlink()
    for command in ("run", "status"):
        ran = metrocli(command)
        assert (ran.code, ran.out) == (3, "")
        assert "jobs/first.yaml:4:20: error: inputs.readings: no such file" in ran.err
        assert "jobs/second.yaml:4:20: error: inputs.readings: no such file" in ran.err


def test_random_changes_never_leave_a_stale_result(project: Path, metrocli: Callable[..., Any]) -> None:
    metrocli("run")
    chance = random.Random(3)
    for _ in range(25):
        name = chance.choice(sorted(CHANGES))
        change, expected, _ = CHANGES[name]
        before = {
            path: path.read_bytes() for path in (Path("more.csv"), Path("jobs/first.yaml"), Path("jobs/third.yaml"))
        }
        change()
        same = all(path.read_bytes() == content for path, content in before.items()) and not name.startswith("output")
        assert kinds(metrocli("run")) == ("" if same else expected), name


def test_a_failure_stops_its_dependents_only(project: Path, metrocli: Callable[..., Any]) -> None:
    Path("jobs/first.yaml").write_text(FIRST + "labels: {fail: diverge}\n")
    ran = metrocli("run")
    assert ran.code == 5
    said = actions(ran)
    assert said["first"].startswith("failed")
    assert said["second"] == "not run (jobs/first.yaml failed)"
    assert said["third"].startswith("ran")
    assert "did not converge" in ran.err


def test_a_missed_criterion_is_told_every_time(project: Path, metrocli: Callable[..., Any]) -> None:
    Path("jobs/third.yaml").write_text(THIRD + "require: {sigma0: '< 0.1'}\n")
    assert metrocli("run").code == 6
    again = metrocli("run")
    assert again.code == 6
    assert "jobs/third.yaml: up to date (an acceptance criterion is not met)" in again.out
    assert "not met: sigma0" in metrocli("status").out


def test_summaries_of_a_run(project: Path, metrocli: Callable[..., Any]) -> None:
    jobs = json.loads(metrocli("run", "--json").out)["jobs"]
    assert [job["action"] for job in jobs] == ["ran"] * 3
    assert jobs[0]["summary"]["estimates"]["slope"]["unit"] == "rad"
    assert [job["up_to_date"] for job in json.loads(metrocli("status", "--json").out)["jobs"]] == [True] * 3


FAULTS = {
    "cycle": (
        "jobs/first.yaml", HEAD + "inputs: {readings: ../readings.csv, known: ../results/second.h5}\noutput: ../results/first.h5\n",
        "metrocli.yaml:2:8: error: these jobs need each other's results: jobs/second.yaml <- jobs/first.yaml <- jobs/second.yaml"),
    "itself": (
        "jobs/third.yaml", HEAD + "inputs: {readings: ../more.csv, known: ../results/third.h5}\noutput: ../results/third.h5\n",
        "jobs/third.yaml:5:9: error: the output results/third.h5 is one of the inputs"),
    "one output": ("jobs/third.yaml", THIRD.replace("third.h5", "first.h5"), "jobs/third.yaml:5:9: error: two jobs write"),
    "no job": ("metrocli.yaml", "jobs: [jobs/none.yaml]\n", "metrocli.yaml:1:8: error: no such job file: jobs/none.yaml"),
    "unknown key": ("metrocli.yaml", LIST + "job: x\n", "metrocli.yaml:3:1: error: unknown key 'job'"),
    "twice": ("metrocli.yaml", "jobs: [jobs/first.yaml, jobs/first.yaml]\n", "metrocli.yaml:1:25: error: jobs: 'jobs/first.yaml' is in"),
    "no jobs": ("metrocli.yaml", "project: x\n", "metrocli.yaml:1:1: error: the key 'jobs' is missing"),
    "input of nobody": (
        "jobs/second.yaml", SECOND.replace("first.h5", "fist.h5"), "jobs/second.yaml:4:44: error: inputs.known: no such file"),
    "fault in a job": ("jobs/third.yaml", THIRD.replace("0.1 mm", "1"), "jobs/third.yaml:3:8: error: noise: 1 has no unit"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize("command", ["run", "status", "check"])
def test_a_broken_project_runs_nothing(name: str, command: str, project: Path, metrocli: Callable[..., Any]) -> None:
    file, text, message = FAULTS[name]
    Path(file).write_text(text)
    ran = metrocli(command, project)
    assert (ran.code, ran.out) == (3, "")
    assert message in ran.err
    assert not Path("results").exists()


def test_no_project(job: Path, metrocli: Callable[..., Any]) -> None:
    ran = metrocli("run", "nowhere")
    assert ran.code == 3
    assert "no such project file" in ran.err


def test_a_job_given_as_a_project_is_told_its_own_command(job: Path, metrocli: Callable[..., Any]) -> None:
    ran = metrocli("run", job)
    assert ran.code == 3
    assert f"{job}:2:6: error: this is a job, not a project" in ran.err
    assert f"metrocli straight-line {job}" in ran.err


def test_check_of_a_project_reads_its_tables(project: Path, metrocli: Callable[..., Any]) -> None:
    assert metrocli("check", project).code == 0
    Path("more.csv").write_text("point,x_mm,y_mm\na,1,nan\n")
    ran = metrocli("check", project)
    assert (ran.code, "more.csv:2:5: error" in ran.err) == (3, True)
