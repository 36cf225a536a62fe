"""Each hint appears for an input that calls for it, and not for one that is similar to it."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hints.table import BASES, ROWS, Row
from places import SAMPLES

Metrocli = Callable[..., Any]


def entered(row: Row, folder: Path) -> None:
    """Write the files of a row's base into a folder; they are links until they are changed."""
    base = BASES.get(row.base)
    if callable(base):
        base(folder)
    elif base is not None:
        for name, text in base.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
    else:
        shutil.copytree(SAMPLES / row.base, folder, dirs_exist_ok=True, copy_function=os.symlink)


def changed(edits: dict[str, Callable[[str], str]], folder: Path) -> None:
    for name, edit in edits.items():
        file = folder / name
        text = file.read_text(encoding="utf-8") if file.exists() else ""
        file.unlink(missing_ok=True)
        file.write_text(edit(text), encoding="utf-8")


def shown(row: Row, edits: dict[str, Callable[[str], str]], folder: Path, metrocli: Metrocli) -> str:
    folder.mkdir()
    entered(row, folder)
    changed(edits, folder)
    os.chdir(folder)
    said = ""
    for command in row.command.split(";"):
        ran = metrocli(*command.split())
        assert ran.code in (0, 3, 4, 5, 6), ran.err
        said += f"{ran.err}\n{ran.out}"
    return " ".join(said.split())


def case(row: Row) -> Any:
    marks = (pytest.mark.slow,) if row.slow else ()
    return pytest.param(row, id=re.sub("[^a-z]+", "-", row.hint.lower())[:40], marks=marks)


@pytest.mark.parametrize("row", [case(row) for row in ROWS])
def test_a_hint_appears_only_where_it_fits(
    row: Row, tmp_path: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    hint = re.compile(".{0,500}?".join(map(re.escape, row.hint.split("{}"))))
    provoked = shown(row, row.provoked, tmp_path / "provoked", metrocli)
    assert hint.search(provoked), provoked
    assert row.shows in provoked, provoked
    similar = shown(row, row.similar, tmp_path / "similar", metrocli)
    assert not hint.search(similar), similar
    assert row.instead in similar, similar
