"""Samples: listed, copied, never over something."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from metrocli.cli import init

Metrocli = Callable[..., Any]


@pytest.fixture
def samples(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One sample, with results of a run that are not part of it."""
    home = tmp_path / "samples"
    (home / "line" / "results").mkdir(parents=True)
    (home / "line" / "metrocli.yaml").write_text("jobs: [line.yaml]\n")
    (home / "line" / "README.md").write_text("# A line through readings\n\nMore.\n")
    (home / "line" / "results" / "line.h5").write_text("x")
    (home / "no-sample").mkdir()
    monkeypatch.setattr(init, "samples_folder", lambda: home)
    return tmp_path


def test_samples_are_listed(samples: Path, metrocli: Metrocli) -> None:
    for arguments in (["init"], ["init", samples / "new"]):
        ran = metrocli(*arguments)
        assert (ran.code, ran.out.splitlines()[1:]) == (0, ["  line: A line through readings"])
    assert not (samples / "new").exists()


@pytest.mark.parametrize("there", [False, True])
def test_a_sample_is_copied(there: bool, samples: Path, metrocli: Metrocli) -> None:
    new = samples / "new"
    if there:
        new.mkdir()
    assert metrocli("init", new, "--sample", "line").code == 0
    assert sorted(path.name for path in new.iterdir()) == ["README.md", "metrocli.yaml"]


@pytest.mark.parametrize("there", [False, True])
def test_on_a_full_disk_nothing_is_left(
    there: bool, samples: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch
) -> None:
    new, copied = samples / "new", list[str]()
    if there:
        new.mkdir()

    def full(source: str, target: str) -> None:
        copied.append(target)
        Path(target).touch()
        if len(copied) > 1:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("shutil.copy2", full)
    ran = metrocli("init", new, "--sample", "line")
    assert (ran.code, ran.err) == (3, f"{copied[1]}: error: cannot be written: No space left on device\n")
    assert (list(new.iterdir()) if there else new.exists()) == ([] if there else False)


def test_nothing_is_overwritten(samples: Path, metrocli: Metrocli) -> None:
    new = samples / "new"
    new.mkdir()
    (new / "mine.txt").write_text("x")
    ran = metrocli("init", new, "--sample", "line")
    assert (ran.code, "not empty" in ran.err) == (3, True)
    assert [path.name for path in new.iterdir()] == ["mine.txt"]
    assert metrocli("init", new / "mine.txt", "--sample", "line").code == 3


def test_wrong_use(samples: Path, metrocli: Metrocli) -> None:
    assert "did you mean 'line'?" in metrocli("init", samples / "new", "--sample", "lines").err
    assert metrocli("init", "--sample", "line").code == 2


def test_the_real_home_is_in_the_checkout_or_the_package() -> None:
    assert init.samples_folder().name == "sample_projects"
