"""Projects that never lie: what was read is what is recorded, damage is not believed, nothing foreign is replaced."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from resealing import resealed

from metrocli.errors import InputError
from metrocli.formats import file_bytes as aside
from metrocli.formats import hdf5, images
from metrocli.project import fingerprint, runner
from metrocli.project.job import load
from metrocli.project.pipeline import worst
from metrocli.project.runner import carry_out
from metrocli.project.running import executor
from metrocli.table import Table

HEAD = "metrocli: 1\njob: straight-line\nnoise: 0.1 mm\n"
FIRST = HEAD + "inputs: {readings: ../readings.csv, known: ../known.yaml}\noutput: ../results/first.h5\n"
SECOND = HEAD + "inputs: {readings: ../readings.csv, known: ../results/first.h5}\noutput: ../results/second.h5\n"


@pytest.fixture
def project(job: Path) -> Path:
    """Two jobs; the second uses the result of the first."""
    Path("jobs").mkdir()
    Path("jobs/first.yaml").write_text(FIRST)
    Path("jobs/second.yaml").write_text(SECOND)
    Path("known.yaml").write_text("slope: 1 mm/m\n")
    Path("metrocli.yaml").write_text("jobs: [jobs/first.yaml, jobs/second.yaml]\n")
    return Path()


def ran(metrocli: Callable[..., Any], *options: str) -> list[str]:
    """The jobs that ran."""
    done = metrocli("run", *options)
    assert done.code == 0, done.err
    return [Path(line.split(":")[0]).stem for line in done.out.splitlines() if ": ran" in line]


NO_CHANGE: dict[str, Callable[[], object]] = {
    "comment in the job": lambda: Path("jobs/first.yaml").write_text("# checked\n" + FIRST + "\n\n# end\n"),
    "order of keys": lambda: Path("jobs/first.yaml").write_text("\n".join(sorted(FIRST.splitlines())) + "\n"),
    "notation of a quantity": lambda: Path("jobs/first.yaml").write_text(FIRST.replace("0.1 mm", "100um")),
    "block for flow": lambda: Path("jobs/first.yaml").write_text(
        FIRST.replace("{readings: ../readings.csv, known: ../known.yaml}", "\n  known: '../known.yaml'\n  readings: ../readings.csv")),
    "default written out": lambda: Path("jobs/first.yaml").write_text(FIRST + "iterations: 10\n"),
    "comment in the table": lambda: Path("readings.csv").write_text("# by night\n\n" + Path("readings.csv").read_text()),
    "separator of the table": lambda: Path("readings.csv").write_text(Path("readings.csv").read_text().replace(",", ";")),
    "line ends of the table": lambda: Path("readings.csv").write_text(Path("readings.csv").read_text().replace("\n", "\r\n")),
    "comment in a YAML input": lambda: Path("known.yaml").write_text("# by hand\nslope: 1.0 mm/m\n"),
}  # fmt: skip


@pytest.mark.parametrize("name", NO_CHANGE)
def test_a_change_of_notation_runs_nothing(name: str, project: Path, metrocli: Callable[..., Any]) -> None:
    metrocli("run")
    NO_CHANGE[name]()
    assert "would run" not in metrocli("run", "--dry-run").out
    assert ran(metrocli) == []


def test_a_column_that_is_not_read_counts_as_the_warning_that_it_gives(
    project: Path, metrocli: Callable[..., Any]
) -> None:
    metrocli("run")
    head, *rows = Path("readings.csv").read_text().splitlines()
    Path("readings.csv").write_text("\n".join([f"{head},note,by", *(f"{row},ok,me" for row in rows)]) + "\n")
    assert ran(metrocli) == ["first", "second"]
    other = [f"{row},you,?" for row in rows]
    Path("readings.csv").write_text("\n".join(["# by night", f"{head},by,note", *other]) + "\n")
    assert ran(metrocli) == []
    assert metrocli("rerun", "results/first.h5").code == 0


def test_a_yaml_input_may_have_its_ending_in_capitals(project: Path, metrocli: Callable[..., Any]) -> None:
    Path("known.yaml").rename("KNOWN.YAML")
    Path("jobs/first.yaml").write_text(FIRST.replace("known.yaml", "KNOWN.YAML"))
    assert ran(metrocli) == ["first", "second"]


def test_the_order_of_criteria_is_no_change(project: Path, metrocli: Callable[..., Any]) -> None:
    slope, sigma0 = "  slope.std: ['< 1 rad', '> 0 rad']\n", "  sigma0: '< 1e9'\n"
    Path("jobs/first.yaml").write_text(f"{FIRST}require:\n{slope}{sigma0}")
    assert ran(metrocli) == ["first", "second"]
    Path("jobs/first.yaml").write_text(f"{FIRST}require:\n{sigma0}{slope}")
    assert ran(metrocli) == []
    assert ran(metrocli, "--force") == ["first", "second"]
    Path("jobs/first.yaml").write_text(f"{FIRST}require:\n{slope}{sigma0}")
    assert metrocli("rerun", "results/first.h5").code == 0
    Path("jobs/first.yaml").write_text(f"{FIRST}require:\n{sigma0.replace('1e9', '1e8')}{slope}")
    assert "first" in ran(metrocli)


CHANGE: dict[str, tuple[Callable[[], object], str]] = {
    "a cell": (lambda: Path("readings.csv").write_text(Path("readings.csv").read_text().replace("3100", "3101")), "input ../readings.csv changed"),
    "a YAML input": (lambda: Path("known.yaml").write_text("slope: 2 mm/m\n"), "input ../known.yaml changed"),
    "a setting": (lambda: Path("jobs/first.yaml").write_text(FIRST.replace("0.1 mm", "0.3 mm")), "noise: 0.1 mm -> 0.3 mm"),
    "a new key": (lambda: Path("jobs/first.yaml").write_text(FIRST + "weight: 2\n"), "weight: 2 is new"),
}  # fmt: skip


@pytest.mark.parametrize("name", CHANGE)
def test_a_change_of_meaning_is_named(name: str, project: Path, metrocli: Callable[..., Any]) -> None:
    metrocli("run")
    change, reason = CHANGE[name]
    change()
    assert reason in metrocli("status").out.splitlines()[0]
    assert "first" in ran(metrocli)
    assert ran(metrocli) == []


def test_what_comes_out_the_same_spares_what_depends_on_it(project: Path, metrocli: Callable[..., Any]) -> None:
    metrocli("run")
    before = Path("results/first.h5").stat().st_mtime_ns
    Path("jobs/first.yaml").write_text(FIRST + "iterations: 20\n")
    status = metrocli("status").out.splitlines()
    assert status[1] == "jobs/second.yaml: would run if a result that it uses changes: jobs/first.yaml runs"
    assert ran(metrocli) == ["first"]
    assert Path("results/first.h5").stat().st_mtime_ns == before
    Path("results/first.h5").unlink()
    assert ran(metrocli) == ["first"]


def test_an_input_that_changes_while_the_job_is_loaded_is_not_up_to_date(
    project: Path, metrocli: Callable[..., Any]
) -> None:
    """A YAML input is read with the job; what is recorded is what was read."""
    loaded = load(Path("jobs/first.yaml"))
    Path("known.yaml").write_text("slope: 2 mm/m\n")
    carry_out(loaded)
    assert "input ../known.yaml changed" in metrocli("status").out


def test_an_image_that_changes_while_the_job_runs_is_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((20, 30), np.uint8))
    found = images.read_images([tmp_path / "a.png"])
    assert len(list(found)) == 1
    cv2.imwrite(str(tmp_path / "a.png"), np.ones((20, 30), np.uint8))
    with pytest.raises(InputError, match="changed while the job ran"):
        list(found)


def test_a_damaged_result_is_refused_as_an_input_and_healed(project: Path, metrocli: Callable[..., Any]) -> None:
    metrocli("run")
    path = Path("results/first.h5")
    whole = path.read_bytes()
    path.write_bytes(whole[:-9] + bytes([whole[-9] ^ 4]) + whole[-8:])
    for command in (("show", path), ("export", path, "--to", "csv"), ("straight-line", "jobs/second.yaml")):
        refused = metrocli(*command)
        assert (refused.code, "does not match its digest" in refused.err) == (3, True)
    assert ran(metrocli) == ["first"]
    assert hdf5.read(path)[0].kind == "straight-line"


@pytest.mark.parametrize("length", [0, 1, 7, 100, 3000])
def test_what_is_left_of_a_result_is_made_again(length: int, project: Path, metrocli: Callable[..., Any]) -> None:
    metrocli("run")
    Path("results/first.h5").write_bytes(Path("results/first.h5").read_bytes()[:length])
    assert ran(metrocli) == ["first"]


def test_a_foreign_file_at_the_output_is_kept(project: Path, metrocli: Callable[..., Any]) -> None:
    Path("results").mkdir()
    Path("results/first.h5").write_text("my notes")
    assert "would not run" in metrocli("run", "--dry-run").out.splitlines()[0]
    done = metrocli("run")
    assert (done.code, Path("results/first.h5").read_text()) == (3, "my notes")
    assert "the file exists and is not a result of metrocli" in done.err
    assert ran(metrocli, "--force") == ["first", "second"]


def test_the_worst_exit_code_is_that_of_the_project(project: Path, metrocli: Callable[..., Any]) -> None:
    Path("jobs/first.yaml").write_text(FIRST + "require: {sigma0: '< 0.001'}\n")
    Path("jobs/third.yaml").write_text(HEAD + "inputs: {readings: ../bad.csv}\n")
    Path("bad.csv").write_text("point,x_mm,y_mm\na,1,nan\n")
    Path("metrocli.yaml").write_text("jobs: [jobs/first.yaml, jobs/second.yaml, jobs/third.yaml]\n")
    assert metrocli("run").code == 3
    Path("jobs/second.yaml").write_text(SECOND.replace(", known: ../results/first.h5", "") + "labels: {fail: bug}\n")
    done = metrocli("run")
    assert (done.code, "a planted defect" in done.err) == (1, True)
    assert [worst(codes) for codes in ([], [0, 6], [6, 5, 0], [5, 4], [6, 3, 4], [1, 3])] == [0, 6, 5, 4, 3, 1]


def test_two_names_of_one_folder_are_one(project: Path, metrocli: Callable[..., Any]) -> None:
    Path("results").mkdir()
    Path("link").symlink_to("results")
    Path("jobs/second.yaml").write_text(SECOND.replace("../results/second.h5", "../link/first.h5"))
    done = metrocli("run")
    assert (done.code, "link/first.h5 is one of the inputs" in done.err) == (3, True)
    Path("jobs/second.yaml").write_text(
        SECOND.replace(", known: ../results/first.h5", "").replace("results/second", "link/first"))  # fmt: skip
    assert "two jobs write" in metrocli("run").err
    Path("jobs/second.yaml").write_text(SECOND.replace("../results/first.h5", "../link/first.h5"))
    assert ran(metrocli) == ["first", "second"]


class TestExports:
    """Files beside a result."""

    @pytest.fixture(autouse=True)
    def result(self, project: Path, metrocli: Callable[..., Any]) -> None:
        metrocli("run")
        Path("data").mkdir()

    def test_inputs_are_not_overwritten(self, metrocli: Callable[..., Any]) -> None:
        Path("data/residuals.csv").write_text("point,x_mm\n1,2\n")
        refused = metrocli("export", "results/first.h5", "--to", "csv", "--out", "data")
        assert (refused.code, Path("data/residuals.csv").read_text()) == (3, "point,x_mm\n1,2\n")
        assert "data/residuals.csv: error: the file exists, and metrocli did not write it so" in refused.err
        assert metrocli("export", "results/first.h5", "--to", "csv", "--out", "data", "--force").code == 0

    def test_own_files_are_replaced_until_somebody_edits_them(self, metrocli: Callable[..., Any]) -> None:
        export = ("export", "results/first.h5", "--to", "csv", "--out", "data")
        assert metrocli(*export).code == 0
        Path("jobs/first.yaml").write_text(FIRST.replace("0.1 mm", "0.2 mm"))
        metrocli("run")
        assert metrocli(*export).code == 0
        check = subprocess.run(
            ["sha256sum", "--check", ".metrocli-files"], cwd="data", check=False, capture_output=True
        )
        assert check.returncode == 0
        Path("data/residuals.csv").write_text(Path("data/residuals.csv").read_text() + "note\n")
        assert metrocli(*export).code == 3

    def test_a_table_cannot_lead_out_of_the_folder(self, metrocli: Callable[..., Any]) -> None:
        def climb(file: Any) -> None:
            file.create_group("..x")
            file.move("residuals", "..x/residuals")

        path = Path("results/first.h5")
        resealed(path, climb)
        done = metrocli("export", path, "--to", "csv", "--out", "data/below")
        assert done.code == 0
        assert all(Path(line).parent == Path("data/below") for line in done.out.splitlines())


def test_an_image_cannot_be_written_outside(project: Path, metrocli: Callable[..., Any], monkeypatch: Any) -> None:
    from metrocli.project.simulated import write
    from metrocli.simulation import Simulation

    table = Table({"x": np.array([1.0])}, {"x": "mm"})
    for name in ("../victim.png", "/tmp/victim.png", "a/../../victim.png", ""):
        simulated = Simulation({"a.csv": table}, {}, [(name, lambda: np.zeros((4, 4), np.uint8))])
        with pytest.raises(InputError, match="is not the name of a file inside"):
            list(write(simulated, Path("sim")))
        assert not Path("sim").exists()


@pytest.mark.parametrize(
    ("place", "reason"),
    [
        ("pipe", "a pipe or a device"),
        ("/dev/zero", "a pipe or a device"),
        ("huge", "a job file has at most"),
        ("many", "more than 100000 values"),
    ],
)
def test_absurd_jobs_are_refused_before_they_are_read(
    place: str, reason: str, job: Path, metrocli: Callable[..., Any]
) -> None:
    os.mkfifo("pipe")
    with Path("huge").open("wb") as file:
        file.truncate(1 << 33)
    Path("many").write_text(job.read_text() + "".join(f"k{n}: 1\n" for n in range(350_000)))
    done = metrocli("check", place)
    assert (done.code, reason in done.err) == (3, True)
    assert len(done.err.splitlines()) < 100


def test_a_pattern_over_a_whole_disk_is_refused(job: Path, metrocli: Callable[..., Any], monkeypatch: Any) -> None:
    monkeypatch.setattr("metrocli.settings.files.MOST_FILES", 30)
    for n in range(20):
        Path(f"img/{n}").mkdir(parents=True)
        Path(f"img/{n}/a.png").touch()
    job.write_text(job.read_text().replace("{", "{images: 'img/**/*.png', "))
    assert "looks through more than 30 files" in metrocli("check", job).err


def test_a_pattern_leaves_hidden_files_out(tmp_path: Path) -> None:
    """A Mac writes ._a.png beside a.png on foreign disks."""
    (tmp_path / "img").mkdir()
    for name in ("a.png", "._a.png", ".gitkeep"):
        (tmp_path / "img" / name).touch()
    for pattern, found in (("img/*", ["a.png"]), ("img/.g*", [".gitkeep"])):
        inputs = f"inputs: {{images: {pattern}}}\npattern: {{type: chessboard, columns: 9, rows: 6, pitch: 25 mm}}\n"
        (tmp_path / "board.yaml").write_text(f"metrocli: 1\njob: calibrate-camera\nrig: board\nnoise: 1 px\n{inputs}")
        assert [path.name for one in load(tmp_path / "board.yaml").inputs for path in one.paths] == found


def test_titles_do_not_reach_the_terminal_raw(job: Path, metrocli: Callable[..., Any]) -> None:
    job.write_text(job.read_text() + 'title: "\\e[2J\\e]0;owned\\a\\u009b31m red"\n')
    out = metrocli("straight-line", job).out
    assert "red" in out
    assert not set(map(chr, [*range(9), *range(11, 32), *range(127, 160)])) & set(out)


def test_leftovers_of_the_dead_are_swept_and_the_living_keep_theirs(tmp_path: Path) -> None:
    (tmp_path / ".old.h5.999999.part").touch()
    (tmp_path / "kept.part").touch()
    with aside.atomic_write(tmp_path / "r.h5") as temporary:
        subprocess.run(
            [sys.executable, "-c", "import sys; from pathlib import Path; from metrocli.formats import file_bytes; "
             "file_bytes.sweep(Path(sys.argv[1]))", str(tmp_path)], check=True)  # fmt: skip
        assert temporary.exists()
        temporary.write_text("whole")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kept.part", "r.h5"]


HANGING = """
import sys, time
from metrocli.cli.shell.signals import ending
from metrocli.formats.file_bytes import atomic_write
from pathlib import Path
import ctypes
with ending(), atomic_write(Path(sys.argv[1])) as aside:
    aside.write_text("begun")
    print("ready", flush=True)
    while True:
        try:
            ctypes.CDLL(None).sleep(60)     # a library that does not return
        except BaseException:
            pass                            # and code that swallows what ends others
"""


@pytest.mark.alike
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_what_hangs_and_takes_back_what_was_begun(number: int, tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", HANGING, str(tmp_path / "r.h5")], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None and process.stderr is not None
    process.stdout.readline()
    time.sleep(0.2)
    process.send_signal(number)
    _, err = process.communicate()
    assert process.returncode == {signal.SIGTERM: 143, signal.SIGINT: 130}[signal.Signals(number)]
    assert err.decode().splitlines()[-1] in ("terminated", "interrupted")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("blocks", [1, pytest.param(40, marks=pytest.mark.slow)])
def test_a_full_disk_is_a_clear_fault(blocks: int, tmp_path: Path) -> None:
    from metrocli.cli.commands import run

    run(["init", str(tmp_path / "p"), "--sample", "gear-m3d3"])
    call = f"ulimit -f {blocks}; exec '{sys.executable}' -m metrocli multilaterate {tmp_path}/p/jobs/tip3.yaml"
    done = subprocess.run(["bash", "-c", call], capture_output=True, text=True, check=False)
    assert (done.returncode, "tip3.h5: error: cannot be written: File too large" in done.stderr) == (3, True)
    assert not list((tmp_path / "p").rglob("*.part")) and not list((tmp_path / "p").rglob("*.h5"))


def test_a_limit_on_memory_leaves_room_for_the_files_that_there_are(
    project: Path, metrocli: Callable[..., Any]
) -> None:
    """A file is read into a buffer of its own size, not of the largest size that is read."""
    metrocli("run")
    limited = "import resource, sys; resource.setrlimit(resource.RLIMIT_AS, (1_000_000_000,) * 2)\n"
    limited += "from metrocli.formats import hdf5; print(hdf5.read_label(sys.argv[1]).kind)"
    read = subprocess.run([sys.executable, "-c", limited, "results/first.h5"], capture_output=True, text=True)
    assert read.stdout == "straight-line\n", read.stderr


@pytest.mark.parametrize("command", [("run",), ("straight-line", "jobs/first.yaml")])
def test_too_little_memory_is_no_defect(
    command: tuple[str, ...], project: Path, metrocli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def too_large(*arguments: Any) -> Any:
        raise MemoryError

    for module in (executor, runner):
        monkeypatch.setattr(module, "compute", too_large)
    done = metrocli(*command)
    assert (done.code, "Traceback" in done.err) == (3, False)
    assert "error: the memory that this program may take is not enough" in done.err


def test_every_sample_has_a_meaning_that_comments_do_not_change(tmp_path: Path) -> None:
    """For every kind of job: all its settings have a digest, the same wherever the project lies."""
    from places import SAMPLES

    for path in sorted(SAMPLES.glob("*/jobs/*.yaml")):
        copy = tmp_path / path.parents[1].name
        if not copy.exists():
            shutil.copytree(path.parents[1], copy, ignore=shutil.ignore_patterns("results"))
        other = copy / "jobs" / path.name
        other.write_text("# copied\n" + other.read_text())
        try:
            first = fingerprint.of_job(load(path))
        except InputError:
            continue  # the results that it uses are not there yet
        assert fingerprint.of_job(load(other)) == first


@pytest.mark.parametrize("edited", [False, True])
def test_a_job_never_runs_with_fewer_images_unasked(edited: bool, job: Path, metrocli: Callable[..., Any]) -> None:
    Path("img/b").mkdir(parents=True)
    for n, name in enumerate(("img/a.png", "img/b/c.png")):
        cv2.imwrite(name, np.full((20, 30), n, np.uint8))
    job.write_text(job.read_text().replace("{", "{images: 'img/**/*.png', "))
    Path("metrocli.yaml").write_text("jobs: [line.yaml]\n")
    assert metrocli("run").code == 0
    Path("img/a.png").unlink()
    if edited:
        job.write_text(job.read_text() + "title: another\n")
    for command in ("run", "status"):
        refused = metrocli(command)
        assert (refused.code, "the input img/a.png of the last result is gone" in refused.err) == (3, True)
    if edited:
        job.write_text(job.read_text().replace("img/**/*.png", "img/b/*.png"))
        assert metrocli("run").code == 0, "the job names the others only"
    else:
        assert metrocli("run", "--force").code == 0


def test_a_lost_image_that_the_pattern_no_longer_names_is_not_missed(job: Path, metrocli: Callable[..., Any]) -> None:
    """A star of a pattern ends at a slash: `img/*.png` does not name `img/b/c.png`."""
    Path("img/b").mkdir(parents=True)
    for n, name in enumerate(("img/a.png", "img/b/c.png")):
        cv2.imwrite(name, np.full((20, 30), n, np.uint8))
    plain = job.read_text()
    job.write_text(plain.replace("{", "{images: 'img/**/*.png', "))
    Path("metrocli.yaml").write_text("jobs: [line.yaml]\n")
    assert metrocli("run").code == 0
    Path("img/b/c.png").unlink()
    job.write_text(plain.replace("{", "{images: 'img/*.png', "))
    assert metrocli("run").code == 0
