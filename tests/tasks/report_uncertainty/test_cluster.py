"""Chunks on a Dask cluster of real processes: same bits, also when a worker dies; no cluster, a clear error."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import ROOT
from tasks.report_uncertainty.jobs import carry_out, write

from metrocli.errors import InputError
from metrocli.formats import hdf5
from metrocli.project.running import cluster as cluster_of_jobs
from metrocli.uncertainty.workers import dask_cluster
from metrocli.uncertainty.workers.dask_cluster import Versions

JOB: dict[str, Any] = {
    "quantities": {
        "a": {"value": 1, "std": 0.1, "dof": 7}, "b": {"value": 2, "half_width": 0.3}, "c": {"value": 3, "std": 0.2},
    },
    "correlations": [{"between": ["b", "c"], "value": 0.4}],
    "measurands": {"y": {"model": "a*b + exp(c)"}, "z": {"model": "a - c"}},
}  # fmt: skip
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


def test_no_scheduler_at_the_address_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ran = carry_out(tmp_path, JOB, "job", "--scheduler", "tcp://127.0.0.1:1")
    assert ran.code == 3
    assert "no Dask scheduler answers there" in capsys.readouterr().err
    assert not ran.path.exists()


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:port", "tcp://127.0.0.1:99999", "tcp://"])
def test_an_address_that_is_none_is_told(address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert carry_out(tmp_path, JOB, "job", "--scheduler", address).code == 3
    assert f"--scheduler {address}" in capsys.readouterr().err


def test_no_scheduler_file_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert carry_out(tmp_path, JOB, "job", "--scheduler", str(tmp_path / "none.json")).code == 3
    assert "no such scheduler file" in capsys.readouterr().err
    (tmp_path / "other.json").write_text("[1]")
    assert carry_out(tmp_path, JOB, "job", "--scheduler", str(tmp_path / "other.json")).code == 3
    assert "this is not a scheduler file of Dask" in capsys.readouterr().err


class Deserted:
    """A client whose scheduler answers and has no workers."""

    status = "running"

    def nthreads(self) -> dict[str, int]:
        return {}


def test_a_cluster_that_loses_all_workers_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")

    def never(*arguments: object, **options: object) -> None:
        raise TimeoutError

    monkeypatch.setattr(distributed, "wait", never)
    monkeypatch.setattr(dask_cluster, "PATIENCE_WITH_WORKERS_S", 0.05)
    with pytest.raises(ConnectionError, match="lost all workers"):
        dask_cluster.first_finished(Deserted(), {"a future"})


class OfAnotherVersion:
    """A client with a worker that answers with other versions, and one that has just died."""

    def run(self, asked: Callable[..., str], *arguments: object, **options: object) -> dict[str, object]:
        others = "metrocli 0.0.1 with numpy 1.0 and Python 3.4"
        return {"here": asked(*arguments), "there": others, "dead": OSError("gone")}

    def wait_for_workers(self, *arguments: object, **options: object) -> None:
        return None

    def close(self) -> None:
        return None


def test_workers_of_other_versions_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    monkeypatch.setattr(distributed, "Client", lambda *arguments, **options: OfAnotherVersion())
    with (
        pytest.raises(InputError, match=r"workers have metrocli 0\.0\.1 with numpy 1\.0 and Python 3\.4, and this is"),
        dask_cluster.cluster("ucx://anywhere"),
    ):
        pass


class Gone:
    """A client whose scheduler has ended after the work was sent."""

    status = "closed"

    def scatter(self, work: object, **options: object) -> object:
        return work

    def nthreads(self) -> dict[str, int]:
        return {"worker": 1}

    def submit(self, *arguments: object, **options: object) -> str:
        return "a future"


def test_a_cluster_that_ends_in_the_middle_is_an_error_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")

    def never(*arguments: object, **options: object) -> None:
        raise TimeoutError

    @contextmanager
    def gone(address: str, more: Any) -> Iterator[Gone]:
        yield Gone()

    monkeypatch.setattr(distributed, "wait", never)
    monkeypatch.setattr(dask_cluster, "cluster", gone)
    with (
        pytest.raises(InputError, match=r"tcp://there: the cluster has ended \(ConnectionError\); run again"),
        dask_cluster.ordered_on("tcp://there") as ordered,
    ):
        list(ordered(abs, [1, 2]))


@dataclass
class AtOnce:
    """A client with one worker that computes each task when it is sent, and lists how many numbers each has."""

    sizes: list[int] = field(default_factory=list)

    def scatter(self, work: object, **options: object) -> object:
        return work

    def nthreads(self) -> dict[str, int]:
        return {"worker": 1}

    def submit(
        self, do: Callable[..., object], work: object, numbers: list[int], versions: Versions, **options: object
    ) -> Future[object]:
        self.sizes.append(len(numbers))
        found: Future[object] = Future()
        found.set_result(do(work, numbers, versions))
        return found


def test_short_chunks_travel_together_and_come_back_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_cluster, "first_finished", lambda client, futures: futures)
    client = AtOnce()
    found = dask_cluster._on_cluster(client, "tcp://there", lambda number: number * number, range(60))
    assert list(found) == [number * number for number in range(60)]
    assert client.sizes == [1, 1, 1, 1, 25, 25, 6]

    failing = dask_cluster._on_cluster(client, "tcp://there", lambda number: 1 // (11 - number), range(60))
    assert [next(failing) for _ in range(11)] == [0] * 10 + [1], "what comes before an error is kept"
    with pytest.raises(ZeroDivisionError):
        next(failing)
    client.sizes.clear()
    monkeypatch.setattr(dask_cluster, "_TASK_S", 1e-9)
    assert list(dask_cluster._on_cluster(client, "tcp://there", abs, range(9))) == list(range(9))
    assert client.sizes == [1] * 9, "long ones travel alone"


def test_a_worker_that_joins_later_with_other_versions_computes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_cluster, "first_finished", lambda client, futures: futures)
    found = dask_cluster._on_cluster(AtOnce(), "tcp://there", abs, range(60))
    assert next(found) == 0
    asked = Versions.here(None)
    monkeypatch.setattr(dask_cluster, "__version__", "9.9")
    refused = r"workers have metrocli 9\.9 with .*: install the same versions everywhere"
    with pytest.raises(InputError, match=refused):
        list(found)
    with pytest.raises(InputError, match=refused):
        cluster_of_jobs.carry_out([], asked)


SCHEDULER = ["-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]


def test_a_scheduler_without_workers_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    monkeypatch.setattr(dask_cluster, "PATIENCE_WITH_WORKERS_S", 0.5)
    file = tmp_path / "scheduler.json"
    with (tmp_path / "log.txt").open("wb") as log:
        alone = _start([sys.executable, *SCHEDULER, "--scheduler-file", str(file)], log, tmp_path)
        try:
            _wait(file.is_file)
            ran = carry_out(tmp_path, JOB, "job", "--scheduler", str(file))
        finally:
            alone.kill()
            alone.wait(20)
    assert ran.code == 3
    assert "the scheduler has no workers" in capsys.readouterr().err
    assert not ran.path.exists()


@contextmanager
def started(
    folder: Path, count: int = 2, host: str = "127.0.0.1", more: Mapping[str, str] | None = None
) -> Iterator[tuple[Path, list[subprocess.Popen[bytes]]]]:
    """A scheduler and worker processes, as a user starts them."""
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    file = folder / "scheduler.json"
    scheduler = [*SCHEDULER[:3], host, *SCHEDULER[4:], "--scheduler-file", str(file)]
    worker = ["-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    worker += ["--scheduler-file", str(file), "--local-directory"]
    with (folder / "log.txt").open("wb") as log:
        begun = [_start([sys.executable, *scheduler], log, folder, more)]
        try:
            _wait(file.is_file)
            begun += [_start([sys.executable, *worker, str(folder / f"w{n}")], log, folder, more) for n in range(count)]
            yield file, begun[1:]
        finally:
            for process in reversed(begun):
                process.kill()
                process.wait(20)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, list[subprocess.Popen[bytes]]]]:
    with started(tmp_path_factory.mktemp("cluster")) as found:
        yield found


def _start(
    command: list[str], log: Any, folder: Path, more: Mapping[str, str] | None = None
) -> subprocess.Popen[bytes]:
    return subprocess.Popen(command, stdout=log, stderr=log, cwd=folder, env=ENVIRONMENT | dict(more or {}))


def _wait(ready: Any) -> None:
    for _ in range(600):
        if ready():
            return
        time.sleep(0.1)
    raise TimeoutError


def bits(path: Path) -> tuple[Any, ...]:
    """Everything of a result that trials decide."""
    result, _ = hdf5.read(path)
    details = {name: detail["mc"] for name, detail in result.details.items()}
    return np.asarray(result.arrays["monte_carlo_covariance"]).tobytes(), repr(details)


@pytest.mark.alike
@pytest.mark.parametrize("trials", ["adaptive", 400_000, 3_000_000])
def test_a_cluster_gives_the_same_bits(cluster: tuple[Path, Any], trials: Any, tmp_path: Path) -> None:
    job = {**JOB, "monte_carlo": {"trials": trials, "seed": 5}}
    here = carry_out(tmp_path, job, "here", "--workers", "1")
    there = carry_out(tmp_path, job, "there", "--scheduler", str(cluster[0]))
    assert (here.code, there.code) == (0, 0)
    assert bits(here.path) == bits(there.path)


def test_other_workers_share_what_takes_long_in_one_job(cluster: tuple[Path, Any]) -> None:
    import distributed

    library: Any = distributed

    def task(count: int) -> list[tuple[int, int]]:
        def work(number: int) -> tuple[int, int]:
            time.sleep(0.05)
            return number, os.getpid()

        return list(dask_cluster.with_help(work, range(count), 0.1))

    with library.Client(scheduler_file=str(cluster[0])) as client:
        client.wait_for_workers(2)
        # four tasks that wait for chunks, and two threads in all
        found = client.gather(client.map(task, [20, 20, 20, 20], pure=False))
        assert client.submit(task, 0).result() == []
    for one in found:
        assert [number for number, _ in one] == list(range(20))
    assert any(len({process for _, process in one}) == 2 for one in found), "how many share depends on their load"


@pytest.mark.slow
def test_a_worker_killed_in_the_middle_changes_no_bit(
    cluster: tuple[Path, list[subprocess.Popen[bytes]]], tmp_path: Path
) -> None:
    job = {**JOB, "monte_carlo": {"trials": 8_000_000, "seed": 5}}
    here = carry_out(tmp_path, job, "here", "--workers", "1")
    command = [sys.executable, "-m", "metrocli", "report-uncertainty", str(write(tmp_path, job, "there")), "--quiet"]
    running = subprocess.Popen([*command, "--scheduler", str(cluster[0])], cwd=tmp_path, env=ENVIRONMENT)
    _wait(lambda: list((tmp_path / "there.chunks").glob("*.npz")) or running.poll() is not None)
    assert running.poll() is None, "the run was over before a worker could be killed"
    cluster[1][1].kill()
    assert running.wait(120) == 0
    assert bits(here.path) == bits(tmp_path / "there.h5")
    assert not (tmp_path / "there.chunks").exists()


def certificate(folder: Path, name: str) -> dict[str, str]:
    """Make a certificate that signs itself, for this computer only; return it as Dask's configuration names it."""
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("openssl, which makes the certificate of this test, is not installed")
    paths = {"cert": folder / f"{name}.pem", "key": folder / f"{name}-key.pem"}
    made = ["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
    made += ["-addext", "subjectAltName=IP:127.0.0.1", "-out", str(paths["cert"]), "-keyout", str(paths["key"])]
    subprocess.run([openssl, *made], check=True, capture_output=True)
    parts = {f"{who}.{part}": str(path) for who in ("scheduler", "worker", "client") for part, path in paths.items()}
    return {f"distributed.comm.tls.{part}": path for part, path in {"ca-file": str(paths["cert"]), **parts}.items()}


@pytest.mark.slow
def test_an_encrypted_cluster_takes_the_certificates_of_dasks_own_configuration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dask = pytest.importorskip("dask", reason="the extra 'cluster' is not installed")
    ours, others = certificate(tmp_path, "ours"), certificate(tmp_path, "others")
    variables = {f"DASK_{key.upper().replace('.', '__').replace('-', '_')}": path for key, path in ours.items()}
    job = {**JOB, "monte_carlo": {"trials": 200_000, "seed": 5}}
    here = carry_out(tmp_path, job, "here", "--workers", "1")
    with started(tmp_path, 1, "tls://127.0.0.1", variables) as (file, _):
        address = json.loads(file.read_text())["address"]
        assert address.startswith("tls://")

        def refused(scheduler: str, **configuration: str) -> str:
            capsys.readouterr()
            with dask.config.set(configuration):
                ran = carry_out(tmp_path, job, "there", "--scheduler", scheduler)
            printed = capsys.readouterr().err
            assert (ran.code, ran.path.exists(), "Traceback" in printed) == (3, False, False), printed
            return printed

        assert "uses TLS, and no certificate is given" in refused(address)
        assert "uses TLS, and no certificate is given" in refused(str(file))
        assert "has an address tls://" in refused(address.replace("tls", "tcp"))
        lost = str(tmp_path / "lost.pem")
        assert f"certificates {lost}, " in refused(address, **ours | {"distributed.comm.tls.ca-file": lost})
        assert "no Dask scheduler answers there (TLS certificate" in refused(address, **others)
        with dask.config.set(ours):
            there = carry_out(tmp_path, job, "there", "--scheduler", address)
    assert (there.code, bits(here.path) == bits(there.path)) == (0, True)
