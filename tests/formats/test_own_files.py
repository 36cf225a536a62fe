"""Files that metrocli writes for people: it replaces its own, and keeps those of others."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest

from metrocli.errors import InputError
from metrocli.formats import file_bytes as aside
from metrocli.formats.own_files import LIST, write_all

pytestmark = pytest.mark.usefixtures("each_figure_once")


@pytest.mark.parametrize(
    ("words", "file"),
    [
        (("run", "--depfile", "victim.txt"), "victim.txt"),
        (("plot", "results/line.h5", "residuals", "--save", "victim.svg"), "victim.svg"),
        pytest.param(("plot", "results/line.h5", "residuals"), "results/line.residuals.svg", marks=pytest.mark.slow),
        (("report", "results/line.h5"), "results/line.html"),
        pytest.param(("report", ".", "--out", "index.html"), "index.html", marks=pytest.mark.slow),
        (("gather", "--out", "readings.csv"), "readings.csv"),
    ],
)
def test_a_file_of_others_is_kept(words: tuple[str, ...], file: str, job: Path, metrocli: Callable[..., Any]) -> None:
    Path("metrocli.yaml").write_text(f"jobs: [{job.name}]\n")
    job.write_text(job.read_text() + "output: results/line.h5\n")
    assert metrocli("run").code == 0
    kept = Path("readings.csv").read_bytes()
    Path(file).write_bytes(kept)
    refused = metrocli(*words)
    assert (refused.code, Path(file).read_bytes()) == (3, kept), refused.err
    if file == "readings.csv":
        assert metrocli(*words, "--force").code == 3 and Path(file).read_bytes() == kept
    else:
        assert f"{file}: error: the file exists, and metrocli did not write it so" in refused.err
        assert metrocli(*words, "--force").code == 0
        written = Path(file).read_bytes()
        assert written != kept
        assert metrocli(*words).code == 0  # its own file is replaced


def test_writers_at_the_same_time_lose_no_entry(tmp_path: Path) -> None:
    def write(number: int) -> None:
        list(write_all({tmp_path / f"{number}.txt": b"%d" % number}))

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, range(24)))
    listed = dict(line.split("  ")[::-1] for line in (tmp_path / LIST).read_text().splitlines())
    assert listed == {f"{n}.txt": sha256(b"%d" % n).hexdigest() for n in range(24)}


def test_after_a_kill_its_own_files_are_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "a.txt"
    list(write_all({file: b"1"}))
    next(iter(write_all({file: b"2", tmp_path / "b.txt": b"2"})))  # killed after the first file
    file.write_bytes(b"1")  # or before it
    list(write_all({file: b"3"}))
    assert (tmp_path / LIST).read_text().count("a.txt") == 1
    file.write_bytes(b"2")
    with pytest.raises(InputError, match="did not write it so"):
        list(write_all({file: b"4"}))


def test_an_export_does_not_replace_what_the_result_is_made_from(job: Path, metrocli: Callable[..., Any]) -> None:
    job.write_text(job.read_text().replace("readings.csv", "data/residuals.csv") + "output: results/line.h5\n")
    readings = Path("readings.csv").read_bytes()
    list(write_all({Path("data/residuals.csv"): readings}))  # as an import does
    assert metrocli("straight-line", str(job)).code == 0
    refused = metrocli("export", "results/line.h5", "--to", "csv", "--out", "data")
    assert (refused.code, Path("data/residuals.csv").read_bytes()) == (3, readings)
    assert "data/residuals.csv: error: would overwrite this file, which the job reads" in refused.err
    assert not Path("data/estimates.csv").exists()
    assert metrocli("export", "results/line.h5", "--to", "csv", "--out", "data", "--force").code == 3
    assert Path("data/residuals.csv").read_bytes() == readings


@pytest.mark.parametrize(
    "command",
    ["report results/line.h5 --out readings.csv", "plot results/line.h5 residuals --save results/line.h5.png",
     "report results/line.h5 --out {job}", "report results/line.h5 --out results/line.h5"],
)  # fmt: skip
def test_an_input_is_never_an_output(command: str, job: Path, metrocli: Callable[..., Any]) -> None:
    job.write_text(job.read_text() + "output: results/line.h5\n")
    assert metrocli("straight-line", str(job)).code == 0
    held = {path: path.read_bytes() for path in (job, Path("readings.csv"), Path("results/line.h5"))}
    metrocli(*command.format(job=job).split(), "--force")
    assert {path: path.read_bytes() for path in held} == held


def test_a_closed_folder_is_named_by_the_file_that_was_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("metrocli.formats.file_bytes.os.access", lambda *arguments: False)
    with pytest.raises(InputError, match="a.txt: error: cannot be written: no right to write into"):
        list(write_all({tmp_path / "a.txt": b"1"}))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("others", [False, True], ids=["new folders", "a folder with a file"])
def test_a_full_disk_leaves_no_folder_behind(others: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    above, folder = tmp_path / "new", tmp_path / "new" / "deep"
    if others:
        folder.mkdir(parents=True)
        (folder / "theirs.txt").write_text("theirs")
    before = sorted(tmp_path.rglob("*"))

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(aside.os, "fsync", full)
    with pytest.raises(InputError, match="cannot be written: No space left"):
        aside.write_bytes(folder / "result.h5", b"result")
    with pytest.raises(InputError, match="cannot be written: No space left"):
        list(write_all({above / "page.html": b"page", folder / "plot.svg": b"plot"}))
    assert sorted(tmp_path.rglob("*")) == before
