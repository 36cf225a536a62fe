"""Projects on a Dask cluster of real processes: the same results, whatever dies on the way."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from diagnosis.test_command import measured, write
from places import ROOT

from metrocli.formats import hdf5
from metrocli.project import own_effects

JOB = """\
metrocli: 1
job: report-uncertainty
for: {part: ../parts.csv}
quantities: {a: {readings: "../data/{part}.csv", column: l_mm}, b: {value: 2 mm, std: 2 um}}
measurands: {l: {model: "a + b", unit: mm}}
monte_carlo: {trials: 20000}
output: "../results/{part}.h5"
"""
COUNT = 6
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
SCHEDULER = ["-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
WORKER = ["-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-dashboard", "--no-nanny"]


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[Path, list[subprocess.Popen[bytes]]]]:
    """The scheduler file of a cluster with two workers in a folder of their own, and its processes."""
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    file = elsewhere / "scheduler.json"
    with (elsewhere / "log.txt").open("wb") as log:

        def start(*words: str) -> subprocess.Popen[bytes]:
            return subprocess.Popen([sys.executable, *words], cwd=elsewhere, env=ENVIRONMENT, stdout=log, stderr=log)

        begun = [start(*SCHEDULER, "--scheduler-file", str(file))]
        while not file.is_file():
            assert begun[0].poll() is None, (elsewhere / "log.txt").read_text()
            time.sleep(0.1)
        begun += [start(*WORKER, "--scheduler-file", str(file), "--local-directory", str(elsewhere)) for _ in range(2)]
        try:
            yield file, begun
        finally:
            for process in begun:
                process.kill()
                process.wait(20)


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "project"
    (folder / "jobs").mkdir(parents=True)
    (folder / "data").mkdir()
    (folder / "jobs/part.yaml").write_text(JOB)
    (folder / "parts.csv").write_text("part\n" + "".join(f"p{n}\n" for n in range(COUNT)))
    for n in range(COUNT):
        (folder / f"data/p{n}.csv").write_text(f"l_mm\n10.{n}\n10.001\n10.002\n10.003\n")
    (folder / "metrocli.yaml").write_text("jobs: [jobs/part.yaml]\n")
    monkeypatch.chdir(folder)
    return folder


PACKAGE = """\
from metrocli.effects.effect import Effect, Parameter
def offer(kind):
    return [Effect("bow", "the line is bent", (Parameter("size", "length"),))]
"""


@contextmanager
def with_package(folder: Path) -> Iterator[Path]:
    """Install a package with an effect for this process alone, and yield its module."""
    about = folder / "lab_effects-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-effects\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[{own_effects.ENTRY_POINTS}]\nlab = lab_effects:offer\n")
    (folder / "lab_effects.py").write_text(PACKAGE)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        own_effects._offered.cache_clear()
        yield folder / "lab_effects.py"
    own_effects._offered.cache_clear()


def test_another_module_of_a_package_is_another_package(tmp_path: Path) -> None:
    alike = own_effects.alike_for([("multilaterate", ["bow"]), ("multilaterate", [])])
    assert alike is not None and own_effects.alike_for([("multilaterate", [])]) is None
    assert alike() == "no package with the effect 'bow'"
    with with_package(tmp_path) as module:
        own_effects._package.cache_clear()
        before = alike()
        module.write_text(PACKAGE + "# a better formula\n")
        own_effects._package.cache_clear()
        assert before.startswith("lab-effects 1.0 (module ") and alike().startswith("lab-effects 1.0 (module ")
        assert alike() != before
    own_effects._package.cache_clear()


def contents() -> dict[str, str]:
    return {path.stem: hdf5.read_label(path).content for path in sorted(Path("results").glob("*.h5"))}


@pytest.mark.slow
def test_large_files_travel_without_advice_to_programmers(
    cluster: tuple[Path, list[subprocess.Popen[bytes]]], project: Path, metrocli: Callable[..., Any]
) -> None:
    """Dask advises another way to send more than 10 MB, which here would be an error: `filterwarnings`."""
    with Path("data/p0.csv").open("a") as data:
        data.writelines(f"# {n}: {os.urandom(50_000).hex()}\n" for n in range(130))
    done = metrocli("run", "--scheduler", cluster[0], "--only", "jobs/part.yaml[p0]")
    assert (done.code, done.out.count(": ran")) == (0, 1), done.err


@pytest.mark.slow
def test_the_results_are_those_of_this_computer(
    cluster: tuple[Path, list[subprocess.Popen[bytes]]], project: Path, metrocli: Callable[..., Any], tmp_path: Path
) -> None:
    file, processes = cluster
    alone = metrocli("run", "--jobs", 2)
    assert alone.code == 0, alone.err
    local = contents()
    assert len(local) == COUNT
    for path in Path("results").glob("*.h5"):
        path.unlink()
    Path("data/p3.csv").rename("data/p3")
    Path("data/p3.csv").write_text("l_mm\n10\nx\n")
    done = metrocli("run", "--scheduler", file)
    assert (done.code, "\njobs/part.yaml:4:58: error: quantities.a: data/p3.csv:3: 'x'" in done.err) == (3, True), (
        done.err
    )
    assert {name: one for name, one in local.items() if name != "p3"} == contents()
    Path("data/p3").rename("data/p3.csv")
    assert metrocli("run", "--scheduler", file).code == 0
    assert contents() == local

    os.kill(processes[1].pid, signal.SIGKILL)
    for path in Path("results").glob("*.h5"):
        path.unlink()
    again = metrocli("run", "--scheduler", file)
    assert again.code == 0, f"a worker that dies costs no result: {again.err}"
    assert contents() == local

    Path("results/p1.h5").unlink()
    processes[0].kill()
    processes[0].wait()
    gone = metrocli("run", "--scheduler", file)
    assert (gone.code, "--scheduler" in gone.err) == (3, True)
    assert len(contents()) == COUNT - 1
    assert metrocli("run").out.count(": ran") == 1


@pytest.mark.slow
def test_a_diagnosis_is_that_of_this_computer(
    cluster: tuple[Path, list[subprocess.Popen[bytes]]], project: Path, metrocli: Callable[..., Any], tmp_path: Path
) -> None:
    file, _ = cluster
    job = write(project, measured("tracer-drift"))
    with with_package(tmp_path / "packages"):
        lacking = metrocli("diagnose", job, "--scheduler", file)
    told = ["no package with the effect 'bow', and this is", "lab-effects 1.0 (module", "install the same versions"]
    assert (lacking.code, [words in lacking.err for words in told]) == (3, [True] * 3), lacking.err
    diagnosed = [metrocli("diagnose", job, "--json", *more) for more in ([], ["--force", "--scheduler", file])]
    assert [(one.code, one.err) for one in diagnosed] == [(0, "")] * 2
    assert diagnosed[0].out == diagnosed[1].out
    assert json.loads(diagnosed[0].out)["effects"], "without a finding nothing is cross-validated"


@pytest.mark.slow
def test_a_scheduler_that_dies_in_a_run_keeps_what_is_finished(
    cluster: tuple[Path, list[subprocess.Popen[bytes]]], project: Path
) -> None:
    file, processes = cluster
    Path("jobs/part.yaml").write_text(JOB.replace("20000", "600000"))
    command = [sys.executable, "-m", "metrocli", "run", "--scheduler", str(file)]
    run = subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    while not list(Path().glob("results/*.h5")) and run.poll() is None:
        time.sleep(0.05)
    processes[0].kill()
    out, err = run.communicate()
    assert (run.returncode, "finished results are kept" in err.decode()) == (3, True), err
    assert b"Traceback" not in err, err
    assert len(contents()) >= out.decode().count(": ran") > 0
