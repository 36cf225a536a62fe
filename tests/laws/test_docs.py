"""The documents name everything that the tables have."""

from __future__ import annotations

from pathlib import Path

import pytest
from places import DOCS

from metrocli import errors, settings, units
from metrocli.tasks import KINDS

README = (DOCS.parent / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "dimension", ["length", "angle", "slope", "ratio", "time", "temperature", "pressure", "humidity", "pixel", "speed"]
)
def test_the_endings_of_columns_are_listed(dimension: str) -> None:
    text = (DOCS / "files.md").read_text(encoding="utf-8")
    assert all(f"_{suffix}" in text for suffix in units.suffixes(dimension))


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_is_in_the_readme(kind: str) -> None:
    assert f"metrocli {kind}" in README


def test_each_exit_code_is_in_the_readme() -> None:
    kinds = (errors.UsageError, errors.InputError, errors.UndeterminedError, errors.NotConvergedError)
    assert all(f"| {kind.exit_code} |" in README for kind in kinds)


@pytest.mark.parametrize(
    "spec",
    [
        name
        for name, value in vars(settings).items()
        if isinstance(value, type) and hasattr(value, "read") and name[0] != "_" and name != "Spec"
    ],
)
def test_each_specification_of_settings_is_explained(spec: str) -> None:
    assert f"{spec}(" in (DOCS / "adding.md").read_text(encoding="utf-8")


def test_the_first_job_of_the_readme_is_one(tmp_path: Path) -> None:
    from metrocli.project.job import load

    block = README.split("## A first job")[1].split("\n\n")[1]
    path = tmp_path / "camera.yaml"
    path.write_text("\n".join(line[4:] for line in block.splitlines()), encoding="utf-8")
    (tmp_path / "img").mkdir()
    (tmp_path / "img" / "a.jpg").write_bytes(b"x")
    assert load(path).kind == "calibrate-camera"
    assert len(block.splitlines()) <= 15


def test_the_fault_of_the_readme_is_told_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from metrocli.errors import InputError
    from metrocli.project.job import load

    block = README.split("## A first job")[1].split("\n\n")[1].replace("0.1 px", "0,1 px")
    monkeypatch.chdir(tmp_path)
    Path("camera.yaml").write_text("\n".join(line[4:] for line in block.splitlines()), encoding="utf-8")
    Path("img").mkdir()
    Path("img/a.jpg").write_bytes(b"x")
    with pytest.raises(InputError) as caught:
        load(Path("camera.yaml"))
    assert all(line.strip() in README for line in str(caught.value).splitlines())
