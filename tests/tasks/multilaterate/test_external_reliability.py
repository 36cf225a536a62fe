"""A wrong length moves its point as far as the result states, in the frame of the free network."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks.command_speed import network
from metrocli.formats import hdf5
from metrocli.table import Table


@pytest.mark.alike
@pytest.mark.parametrize(
    ("tracers", "datum"), [(4, ""), (7, ""), pytest.param(4, "datum: points\n", marks=pytest.mark.slow)]
)
def test_a_wrong_length_moves_its_point_as_stated(
    tmp_path: Path, metrocli: Callable[..., object], tracers: int, datum: str
) -> None:
    job = network(tmp_path / "network", 12, tracers)
    text = job.read_text() + datum
    job.write_text(text)
    if datum:  # three points that are known exactly hold the frame
        points = (job.parent / "points.csv").read_text().splitlines()
        held = [f"{line},{0.0 if k < 3 else ''}" for k, line in enumerate(points[1:])]
        (job.parent / "points.csv").write_text("\n".join([points[0] + ",sigma_mm", *held]) + "\n")

    def solved() -> tuple[Table, Table]:
        metrocli("multilaterate", job, "--force", "--quiet", "--accept-doubtful")
        result = hdf5.read(job.parent / "result.h5")[0]
        return result.tables["points"], result.tables["residuals"]

    before, residuals = solved()
    lengths = job.parent / "lengths.csv"
    lines = lengths.read_text().splitlines()
    row = 5 * tracers + 2
    point, tracer, value = lines[row + 1].split(",")
    error = float(residuals.numbers("detectable")[row])
    lines[row + 1] = f"{point},{tracer},{float(value) + error!r}"
    lengths.write_text("\n".join(lines) + "\n")
    after, _ = solved()
    at = before.texts("point").index(point)
    moved = np.linalg.norm(after.stacked("xyz")[at] - before.stacked("xyz")[at])
    assert re.match(r"P0+5$", point)
    assert moved == pytest.approx(residuals.numbers("moves_point")[row], rel=1e-3)
