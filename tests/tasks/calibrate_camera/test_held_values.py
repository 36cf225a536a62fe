"""Lens values that a job holds: a wrong one makes the result doubtful, also where the noise follows the residuals."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tasks.shared.images import small_jobs

Metrocli = Callable[..., Any]


@pytest.mark.alike
@pytest.mark.parametrize("name", ["aspect", "skew"])
@pytest.mark.parametrize("noise", ["estimated", "0.1 px"])
def test_a_held_value_that_the_readings_contradict_is_told(
    metrocli: Metrocli, tmp_path: Path, name: str, noise: str
) -> None:
    job = small_jobs.board(tmp_path)
    right = metrocli("calibrate-camera", job, "--set", f"camera.{name}=0", "--set", f"noise={noise}")
    assert right.code == 0 and "is held at" not in right.out + right.err
    wrong = metrocli("calibrate-camera", job, "--set", f"camera.{name}=0.003", "--set", f"noise={noise}", "--force")
    assert wrong.code == 6
    seen = (wrong.out + wrong.err).split(f"{name} is held at 0.003, but the readings see ")[1].split(":")[0]
    assert abs(float(seen)) < 2e-4
