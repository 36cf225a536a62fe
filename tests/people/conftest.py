"""Inputs that people brought, from the folder of cases outside; tests that need an absent one skip."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from places import SHARED

PUBLIC = SHARED / "cases" / "public"


@pytest.fixture
def case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Path]:
    """Enter a temporary folder with the files of a case."""

    def enter(name: str) -> Path:
        if not (PUBLIC / name).exists():
            pytest.skip(f"the case {name} is not here")
        folder = tmp_path / name
        shutil.copytree(PUBLIC / name, folder, copy_function=shutil.copyfile)
        for path in (folder, *folder.rglob("*")):
            path.chmod(0o755 if path.is_dir() else 0o644)
        monkeypatch.chdir(folder)
        return folder

    return enter
