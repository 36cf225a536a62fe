"""Runs of a project: several at once, parts of it, for Make, one at a time, and nothing to do."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from benchmarks.projects.hard_ends import groups_at_work
from metrocli.errors import InputError
from metrocli.formats import hdf5
from metrocli.project.running import executor, memo
from metrocli.project.running.executor import processes
from metrocli.project.running.files import locked
from metrocli.project.steps import load_project

JOB = """\
metrocli: 1
job: report-uncertainty
quantities: {{a: {{value: {value} mm, std: 1 um}}}}
measurands: {{l: {{model: "2*a", unit: mm}}}}
monte_carlo: {{trials: 1000}}
output: ../results/{name}.h5
"""
USER = """\
metrocli: 1
job: report-uncertainty
inputs: {{results: {{part: ../results/{used}.h5}}}}
measurands: {{l: {{model: "2*part.l", unit: mm}}}}
monte_carlo: {{trials: 1000}}
output: ../results/{name}.h5
"""
ALL = ("a", "b", "c", "d")


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Four jobs: b uses a, d uses c."""
    monkeypatch.chdir(tmp_path)
    Path("jobs").mkdir()
    for name, used in (("a", ""), ("b", "a"), ("c", ""), ("d", "c")):
        text = USER.format(name=name, used=used) if used else JOB.format(name=name, value=10)
        Path(f"jobs/{name}.yaml").write_text(text)
    Path("metrocli.yaml").write_text("jobs: [jobs/a.yaml, jobs/b.yaml, jobs/c.yaml, jobs/d.yaml]\n")
    return tmp_path


def ran(done: Any) -> str:
    return "".join(Path(line.split(":")[0]).stem for line in done.out.splitlines() if ": ran" in line)


def test_several_at_once_give_the_same_results(project: Path, metrocli: Callable[..., Any]) -> None:
    assert metrocli("run").code == 0
    alone = {name: hdf5.read_label(Path(f"results/{name}.h5")).content for name in ALL}
    for name in ALL:
        Path(f"results/{name}.h5").unlink()
    Path("jobs/c.yaml").write_text(JOB.format(name="c", value="0 um, std: 0"))
    done = metrocli("run", "--jobs", 2)
    assert done.code == 3, "one job has a fault, and nothing begins"
    Path("jobs/c.yaml").write_text(JOB.format(name="c", value=10).replace("2*a", "2*sqrt(-1*a*a)"))
    done = metrocli("run", "--jobs", 2)
    assert done.code == 3
    assert (sorted(ran(done)), "jobs/d.yaml: not run (jobs/c.yaml failed)" in done.out) == (["a", "b"], True)
    assert done.err.splitlines()[-1] == "4 jobs: 2 ran, 1 failed, 1 not run"
    Path("jobs/c.yaml").write_text(JOB.format(name="c", value=10))
    assert sorted(ran(metrocli("run", "--jobs", 2))) == ["c", "d"]
    assert {name: hdf5.read_label(Path(f"results/{name}.h5")).content for name in ALL} == alone


def test_a_result_that_stays_is_no_older_than_its_job_after_only(project: Path, metrocli: Callable[..., Any]) -> None:
    result = Path("results/d.h5")
    assert metrocli("run").code == 0
    os.utime(result, (1e9, 1e9))
    assert metrocli("run").code == 0 and result.stat().st_mtime == 1e9, "a run of all leaves its time"
    assert ran(metrocli("run", "--only", "results/d.h5")) == ""
    used = (Path("jobs/d.yaml"), Path("results/c.h5"), Path("metrocli.yaml"))
    assert all(result.stat().st_mtime_ns >= path.stat().st_mtime_ns for path in used)


def test_parts_of_a_project(project: Path, metrocli: Callable[..., Any]) -> None:
    assert ran(metrocli("run", "--only", "jobs/d.yaml")) == "cd"
    assert ran(metrocli("run", "--only", "results/b.h5", "--dry-run")) == ""
    assert ran(metrocli("run", "--from", "jobs/a.yaml")) == "ab"
    assert ran(metrocli("run")) == ""
    Path("jobs/a.yaml").write_text(JOB.format(name="a", value=11))
    Path("jobs/c.yaml").write_text(JOB.format(name="c", value=11))
    assert ran(metrocli("run", "--from", "jobs/c.yaml")) == "cd"
    assert ran(metrocli("run")) == "ab"
    unknown = metrocli("run", "--only", "jobs/e.yaml")
    assert (unknown.code, "did you mean" in unknown.err) == (2, True)


def test_summaries_for_programs(project: Path, metrocli: Callable[..., Any]) -> None:
    dry = json.loads(metrocli("run", "--dry-run", "--json").out)["jobs"]
    assert [(one["job"], one["would"]) for one in dry] == [(f"jobs/{name}.yaml", "runs") for name in ALL]
    done = json.loads(metrocli("run", "--json").out)
    assert (done["exit_code"], [one["action"] for one in done["jobs"]]) == (0, ["ran"] * 4)
    Path("jobs/a.yaml").write_text(JOB.format(name="a", value=11))
    dry = json.loads(metrocli("run", "--dry-run", "--json").out)["jobs"]
    assert [one["would"] for one in dry] == ["runs", "depends", "up to date", "up to date"]
    assert dry[0]["reason"] == "quantities.a.value: 10 mm -> 11 mm"


def test_errors_for_programs(project: Path, metrocli: Callable[..., Any]) -> None:
    Path("jobs/a.yaml").write_text(JOB.format(name="a", value=11).replace("quantities", "quantitys"))
    for command in (("run",), ("check", "jobs/a.yaml"), ("report-uncertainty", "jobs/a.yaml"), ("status",)):
        failed = metrocli(*command, "--json")
        found = json.loads(failed.out)
        assert (failed.code, found["exit_code"], found["status"]) == (3, 3, "error")
        fault = next(one for one in found["errors"] if one["message"] == "unknown key 'quantitys'")
        assert (fault["file"], fault["line"], fault["column"]) == ("jobs/a.yaml", 3, 1)
        assert fault["hint"] == "did you mean 'quantities'?"


def test_errors_for_programs_have_the_part_of_a_long_line_that_is_shown(
    project: Path, metrocli: Callable[..., Any]
) -> None:
    Path("jobs/a.yaml").write_text("a" * 100_000)
    (fault,) = json.loads(metrocli("check", "jobs/a.yaml", "--json").out)["errors"]
    assert (fault["source"], fault["line"]) == ("a" * 160, 1)


def test_make_learns_what_results_depend_on(project: Path, metrocli: Callable[..., Any]) -> None:
    Path("jobs/b c.yaml").write_text(Path("jobs/b.yaml").read_text().replace("b.h5", "b c.h5"))
    Path("metrocli.yaml").write_text("jobs: [jobs/a.yaml, 'jobs/b c.yaml']\n")
    assert metrocli("run", "--depfile", "jobs.d").code == 0
    assert Path("jobs.d").read_text().splitlines() == [
        "results/a.h5: jobs/a.yaml metrocli.yaml",
        "results/b\\ c.h5: jobs/b\\ c.yaml metrocli.yaml results/a.h5",
        "jobs.d: jobs/a.yaml metrocli.yaml jobs/b\\ c.yaml", "jobs/a.yaml:", "metrocli.yaml:", "jobs/b\\ c.yaml:",
    ]  # fmt: skip
    Path("Makefile").write_text("include jobs.d\nresults/%.h5:\n\t@echo made $@\n")
    for path in ("results/a.h5", "results/b c.h5"):
        os.utime(path)
    command = ["make", "--no-print-directory", "results/a.h5"]
    alone = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    made = subprocess.run(command, env=alone, capture_output=True, text=True, check=True)
    assert "is up to date" in made.stdout
    os.utime("jobs/a.yaml", (time.time() + 5, time.time() + 5))
    made = subprocess.run(command, env=alone, capture_output=True, text=True, check=True)
    assert made.stdout == "made results/a.h5\n"


def test_make_learns_of_lists_of_parts_and_folders_of_images(job: Path, metrocli: Callable[..., Any]) -> None:
    names = ("a:b", "c*?[d", "e #$f")
    job.write_text(job.read_text() + "for: {part: parts.csv}\noutput: '{part}.h5'\n")
    Path("parts.csv").write_text("part\n" + "".join(f"{name}\n" for name in names))
    Path("metrocli.yaml").write_text("jobs: [line.yaml]\n")
    assert metrocli("run", "--depfile", "jobs.d").code == 0
    Path("Makefile").write_text("include jobs.d\n%.h5:\n\t@echo made\n")
    alone = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    for said in ("is up to date.\n", "made\n"):
        for name in names:
            command = ["make", "--no-print-directory", f"{name}.h5"]
            made = subprocess.run(command, env=alone, capture_output=True, text=True, check=True)
            assert made.stdout.endswith(said), name
        os.utime("parts.csv", (time.time() + 5, time.time() + 5))
    Path("parts.csv").write_text("part\n50%\n")
    done = metrocli("run", "--dry-run", "--depfile", "jobs.d")
    assert (done.code, "50%.h5: error: Make cannot read this name" in done.err) == (3, True)
    metrocli("init", "board", "--sample", "board-camera")
    assert metrocli("run", "board", "--dry-run", "--depfile", "board.d").code == 0
    assert " board/images" in Path("board.d").read_text().replace("\n", " ").split("board/images/")[-1]


@pytest.fixture
def shots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A job whose images are those of all folders of a name."""
    monkeypatch.chdir(tmp_path)
    for folder in ("shots1", "shots2", "jobs", "results"):
        Path(folder).mkdir()
    Path("metrocli.yaml").write_text("jobs: [jobs/camera.yaml]\n")
    Path("jobs/camera.yaml").write_text(
        "metrocli: 1\njob: calibrate-camera\nrig: board\ninputs: {images: ../shots*/a.png}\noutput: ../results/c.h5\n"
        "pattern: {type: chessboard, columns: 9, rows: 6, pitch: 25 mm}\nnoise: 0.1 px\n"
        "camera: {image_size: [640, 480], estimate: [f]}\n"
    )
    for name in ("shots1/a.png", "results/c.h5"):
        Path(name).touch()
    return tmp_path


@pytest.mark.parametrize("change", ["shots2/a.png", "shots3/b.png"])
def test_make_learns_of_images_in_new_folders_and_makes_its_rules_again(
    change: str, shots: Path, metrocli: Callable[..., Any]
) -> None:
    assert metrocli("run", "--dry-run", "--depfile", "jobs.d", "--force").code == 0
    Path("Makefile").write_text("include jobs.d\njobs.d:\n\t@echo rules; touch $@\n%.h5:\n\t@echo made\n")
    os.utime("results/c.h5", (time.time() + 5, time.time() + 5))
    alone = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    command = ["make", "--no-print-directory", "results/c.h5"]
    before = subprocess.run(command, env=alone, capture_output=True, text=True, check=True)
    assert before.stdout.endswith("is up to date.\n"), (
        "a file that it writes beside the folders does not start it again"
    )
    # the clock of a file system ticks every few milliseconds: what changes now is certainly younger than these
    now = time.time()
    for place in (*Path().rglob("*"), Path()):
        os.utime(place, (now - 10, now - 10))
    os.utime("jobs.d", (now - 5, now - 5))
    Path("shots3").mkdir(exist_ok=True)
    Path(change).touch()
    for place in ("shots1/a.png", "results/c.h5"):
        os.utime(place, (0, 0))
    after = subprocess.run(command, env=alone, capture_output=True, text=True, check=True)
    assert after.stdout == "rules\nmade\n"


@pytest.mark.parametrize("change", ["shots2/a.png", "shots3", "shots1/b.png"])
def test_a_new_folder_that_a_pattern_matches_ends_the_memo(change: str, shots: Path) -> None:
    memo.remember(Path("metrocli.yaml"), load_project(Path()), memo.now_ns() + 10**10)
    assert memo.unmoved_jobs("metrocli.yaml") is not None
    Path(change).touch()
    assert memo.unmoved_jobs("metrocli.yaml") is None


def test_results_keep_their_time_when_nothing_changed(project: Path, metrocli: Callable[..., Any]) -> None:
    metrocli("run")
    before = {name: Path(f"results/{name}.h5").stat().st_mtime_ns for name in ALL}
    assert ran(metrocli("run", "--force")) == "abcd"
    assert {name: Path(f"results/{name}.h5").stat().st_mtime_ns for name in ALL} == before


HOLD = """
import sys, time
from pathlib import Path
from metrocli.project.running.files import locked
with locked(Path("metrocli.yaml"), False):
    print("held", flush=True)
    time.sleep(60)
"""


def test_one_run_at_a_time_and_the_lock_dies_with_its_process(project: Path, metrocli: Callable[..., Any]) -> None:
    holder = subprocess.Popen([sys.executable, "-c", HOLD], stdout=subprocess.PIPE)
    assert holder.stdout is not None
    holder.stdout.readline()
    refused = metrocli("run")
    assert (refused.code, "another run works on this project" in refused.err) == (3, True)
    assert metrocli("run", "--dry-run").code == 0
    waiting = subprocess.Popen([sys.executable, "-m", "metrocli", "run", "--wait"], stdout=subprocess.DEVNULL)
    time.sleep(0.5)
    assert waiting.poll() is None
    holder.kill()
    holder.wait()
    holder.stdout.close()
    assert waiting.wait() == 0
    with (
        locked(Path("metrocli.yaml"), False),
        pytest.raises(InputError, match="another run"),
        locked(Path("metrocli.yaml"), False),
    ):
        pass
    assert sorted(os.listdir()) == [memo.NAME, "jobs", "metrocli.yaml", "results"]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the results of a run are kept for the tests of the memo, whose jobs are the same."""
    return tmp_path_factory.mktemp("run") / "results"


class TestMemo:
    """What is remembered of a run that leaves nothing to do."""

    @pytest.fixture(autouse=True)
    def settled(
        self, project: Path, results: Path, metrocli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        if results.is_dir():
            shutil.copytree(results, "results")
        else:
            metrocli("run")
            shutil.copytree("results", results)
        monkeypatch.setattr("metrocli.project.running.memo._SETTLED_NS", -(10**12))
        metrocli("run")

    def test_the_same_is_printed(self, metrocli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
        assert memo.unmoved_jobs(Path("metrocli.yaml")) == [[f"jobs/{n}.yaml", f"results/{n}.h5"] for n in ALL]
        commands = [("run",), ("run", "--json"), ("run", "--dry-run"), ("run", "--dry-run", "--json")]
        commands += [("status",), ("status", "--json")]
        quick = [metrocli(*one) for one in commands]
        Path(memo.NAME).unlink()
        monkeypatch.setattr("metrocli.project.running.memo.remember", lambda *arguments: None)
        assert [metrocli(*one) for one in commands] == quick

    FILES = ("metrocli.yaml", "jobs/a.yaml", "results/d.h5")

    @pytest.mark.parametrize("file", FILES)
    def test_any_change_ends_it(self, file: str) -> None:
        path = Path(file)
        found, data = path.stat(), path.read_bytes()
        path.write_bytes(data[:-2] + bytes([data[-2] ^ 1]) + data[-1:])
        os.utime(path, ns=(found.st_atime_ns, found.st_mtime_ns))  # as a tool that hides its change would
        assert path.stat().st_size == found.st_size
        assert memo.unmoved_jobs("metrocli.yaml") is None

    def test_a_result_that_is_gone_ends_it(self) -> None:
        Path("results/c.h5").unlink()
        assert memo.unmoved_jobs("metrocli.yaml") is None

    def test_files_that_only_moved_are_read_once(self, monkeypatch: pytest.MonkeyPatch) -> None:
        known = memo.unmoved_jobs("metrocli.yaml")
        for file in self.FILES:
            data = Path(file).read_bytes()
            Path(file).unlink()
            Path(file).write_bytes(data)
            os.utime(file, (0, 0))
        assert memo.unmoved_jobs("metrocli.yaml") == known
        monkeypatch.setattr("metrocli.project.running.memo._seen", lambda *arguments: pytest.fail("read again"))
        assert memo.unmoved_jobs("metrocli.yaml") == known

    def test_a_file_that_is_written_while_it_is_read_is_not_remembered(
        self, metrocli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """The digest would be that of the new bytes, which no run has judged."""
        monkeypatch.setattr("metrocli.project.running.memo._SETTLED_NS", 0)
        Path(memo.NAME).unlink()
        real = memo._looked_at

        def edited(*arguments: Any) -> list[Path]:
            looked_at = list(real(*arguments))
            with Path("jobs/a.yaml").open("a") as file:
                file.write("# edited after it was judged\n")
            # the clock of files moves in ticks, which may be longer than all of this run
            os.utime("jobs/a.yaml", ns=(memo.now_ns() + 1_000_000_000,) * 2)
            return looked_at

        monkeypatch.setattr("metrocli.project.running.memo._looked_at", edited)
        metrocli("run")
        assert not Path(memo.NAME).exists()

    def test_a_damaged_memo_is_not_used(self) -> None:
        Path(memo.NAME).write_text(Path(memo.NAME).read_text()[:-9])
        assert memo.unmoved_jobs(Path("metrocli.yaml")) is None

    @pytest.mark.parametrize(
        "change",
        [
            {"jobs": [1, 2]},
            {"jobs": {"a": 1}},
            {"files": {}},
            {"files": ["metrocli.yaml"]},
            {"jobs": [["other", "x.h5"]]},
        ],
    )
    def test_a_memo_that_no_run_wrote_is_not_used(self, change: dict[str, Any], metrocli: Callable[..., Any]) -> None:
        held = json.loads(Path(memo.NAME).read_text())
        Path(memo.NAME).write_text(json.dumps(held | change))
        assert memo.unmoved_jobs("metrocli.yaml") is None
        assert metrocli("run").out.count("up to date") == len(ALL)

    def test_a_pipe_in_its_place_is_not_waited_for(self) -> None:
        Path(memo.NAME).unlink()
        os.mkfifo(memo.NAME)
        assert memo.unmoved_jobs("metrocli.yaml") is None

    @pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
    @pytest.mark.parametrize("file", FILES)
    def test_what_a_run_read_and_wrote_is_remembered_by_its_bytes_while_it_is_young(
        self, file: str, jobs: int, metrocli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("metrocli.project.running.memo._SETTLED_NS", 10**12)
        real, stopped = memo._signature, memo.now_ns()  # a clock of files too coarse for the change below
        monkeypatch.setattr(memo, "_signature", lambda path: real(path) and [real(path)[0], stopped, stopped, 1])
        job = Path("jobs/c.yaml")
        job.write_text(job.read_text().replace("1 um", "3 um"))
        assert ran(metrocli("run", "--jobs", jobs)) == "cd"
        assert memo.unmoved_jobs("metrocli.yaml") == [[f"jobs/{n}.yaml", f"results/{n}.h5"] for n in ALL]
        data = Path(file).read_bytes()
        Path(file).write_bytes(data[:-2] + bytes([data[-2] ^ 1]) + data[-1:])
        assert memo.unmoved_jobs("metrocli.yaml") is None

    def test_a_young_file_that_was_edited_while_its_job_ran_is_not_remembered(
        self, metrocli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("metrocli.project.running.memo._SETTLED_NS", 10**12)
        Path(memo.NAME).unlink()
        job, computed = Path("jobs/c.yaml"), executor.compute

        def edited_meanwhile(*arguments: Any) -> Any:
            job.write_text(job.read_text().replace("2 um", "3 um"))
            return computed(*arguments)

        job.write_text(job.read_text().replace("1 um", "2 um"))
        with monkeypatch.context() as patch:
            patch.setattr(executor, "compute", edited_meanwhile)
            assert metrocli("run").code == 0
        assert not Path(memo.NAME).exists()
        assert "-> 3 um" in metrocli("run").out

    def test_a_project_nearer_to_a_job_ends_it(self) -> None:
        Path("jobs/metrocli.yaml").write_text("jobs: [a.yaml]\neffects_from: own.yaml\n")
        assert memo.unmoved_jobs("metrocli.yaml") is None

    def test_a_project_nearer_to_a_job_that_goes_during_the_run_ends_it(
        self, metrocli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        nearer, computed = Path("jobs/metrocli.yaml"), executor.compute
        nearer.write_text("jobs: [a.yaml]\n")
        assert metrocli("run").code == 0
        assert memo.unmoved_jobs("metrocli.yaml") is not None

        def gone_meanwhile(*arguments: Any) -> Any:
            nearer.unlink(missing_ok=True)
            return computed(*arguments)

        Path("results/d.h5").unlink()
        with monkeypatch.context() as patch:
            patch.setattr(executor, "compute", gone_meanwhile)
            assert metrocli("run").code == 0
        assert memo.unmoved_jobs("metrocli.yaml") is None


def test_an_output_that_is_a_broken_link_is_refused_in_words(project: Path, metrocli: Callable[..., Any]) -> None:
    Path("results").mkdir()
    Path("results/a.h5").symlink_to("../nowhere/victim.h5")
    ran_ = metrocli("run", "--only", "jobs/a.yaml")
    assert (ran_.code, "a link to a file that does not exist" in ran_.err) == (3, True), ran_.err


def test_a_process_that_dies_costs_only_that_its_jobs_are_computed_again(project: Path) -> None:
    with processes(2) as executor:
        for step in load_project(project):
            if not step.needs:
                executor.begin(step.name, step.job, False)
        next(iter(executor._pool._processes.values())).kill()
        found: dict[str, Any] = {}
        while len(found) < 2:
            found |= dict(executor.finished())
    assert {name: one.exit_code for name, one in found.items()} == {"jobs/a.yaml": 0, "jobs/c.yaml": 0}, found


@pytest.mark.slow
def test_a_job_that_ends_its_process_fails_alone(
    project: Path, metrocli: Callable[..., Any], straight_line: str
) -> None:
    Path("points.csv").write_text("point,x_mm,y_um\na,0,1000\nb,1000,2000\nc,2000,3100\n")
    ends = f"job: {straight_line}\ninputs: {{readings: ../points.csv}}\nnoise: 1 um\nlabels: {{fail: exit}}\n"
    Path("jobs/b.yaml").write_text(f"metrocli: 1\n{ends}")
    ran_ = metrocli("run", "--jobs", 2, "--json")
    actions = {Path(one["job"]).stem: one["action"] for one in json.loads(ran_.out)["jobs"]}
    assert (ran_.code, actions) == (1, {"a": "ran", "b": "failed", "c": "ran", "d": "ran"})
    assert "its process was ended" in ran_.err and "Traceback" not in ran_.err


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are listed in /proc")
def test_no_process_outlives_a_run_that_is_killed_alone(project: Path) -> None:
    for name in ("a", "c"):
        text = JOB.format(name=name, value=10).replace("1000", "200000000")
        Path(f"jobs/{name}.yaml").write_text(text)
    command = [sys.executable, "-m", "metrocli", "run", "--jobs", "2"]
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    while not list(Path().glob("results/*.chunks/*.npz")):
        assert run.poll() is None
        time.sleep(0.05)
    run.kill()
    run.wait()
    end = time.monotonic() + 20
    while run.pid in groups_at_work() and time.monotonic() < end:
        time.sleep(0.05)
    assert run.pid not in groups_at_work()


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_kill_at_any_moment_loses_nothing_that_was_finished(jobs: int, project: Path) -> None:
    command = [sys.executable, "-m", "metrocli", "run", "--jobs", str(jobs)]
    moments = [0.5, 1.0]
    for moment in moments:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True)
        time.sleep(moment)
        os.killpg(process.pid, signal.SIGKILL)
        out, _ = process.communicate()
        for line in out.decode().splitlines():
            assert hdf5.read(Path(line.split(" -> ")[-1]))[0].kind if " -> " in line else "up to date" in line
    assert subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode == 0
    assert sorted(path.name for path in Path("results").iterdir()) == [f"{name}.h5" for name in ALL]
