"""`part:` in the kinds that measure no part: the refusal says what to write instead."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

INSTEAD = {
    "calibrate-camera": "`part:` in the fit-part job",
    "calibrate-machine": "`scale: {temperature: .., expansion: ..}`",
    "locate-launch-unit": "the effect machine-scale",
    "report-uncertainty": "an entry with `expansion`",
    "selfcal-grid": "the effect artefact-expansion",
}


@pytest.mark.parametrize("kind", INSTEAD)
def test_kinds_without_a_part_say_where_it_belongs(kind: str, tmp_path: Path, metrocli: Callable[..., Any]) -> None:
    job = tmp_path / "job.yaml"
    job.write_text(f"metrocli: 1\njob: {kind}\npart: {{temperature: 25 degC, expansion: 11.5e-6 1/K}}\noutput: o.h5\n")
    listed_at = metrocli("check", job).err
    assert "unknown key 'part'" in listed_at and INSTEAD[kind] in listed_at
