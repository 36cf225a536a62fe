"""Effects of no catalogue that were simulated elsewhere (skipped where they are absent).

One wave, one measurement without an effect, and a step that a drift and a smooth process imitate; `python -m benchmarks laws` judges all.
"""

from __future__ import annotations

import json

import pytest

from benchmarks import laws
from metrocli.project.diagnosed import carry_out
from metrocli.project.job import load

FOLDERS = [folder for folder in laws.folders() if folder.name[:3] in ("004", "007", "011")]


@pytest.mark.skipif(not FOLDERS, reason=f"no cases at {laws.CASES}")
@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_the_law_is_right(folder) -> None:  # type: ignore[no-untyped-def]
    truth = json.loads((folder / "truth.json").read_text())
    assert laws.faults(carry_out(load(folder / "job.yaml")), truth) == []
