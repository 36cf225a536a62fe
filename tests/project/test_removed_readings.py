"""The extended job leaves out what its effects were found without, and is diagnosed in the noise that it states."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.halves import SIGMA, simulated
from metrocli.cli.commands import run
from metrocli.diagnosis.diagnose import diagnose
from metrocli.project.diagnosed import adjusted_job_of, carry_out, write_extended
from metrocli.project.job import load
from metrocli.tasks.calibrate_camera import task as calibrate_camera


def spoilt(table: Path, column: str, rows: list[int], error: float) -> None:
    """Add an error to a column of some rows of a table."""
    first, *lines = table.read_text(encoding="utf-8").splitlines()
    at = first.split(",").index(column)
    for number in rows:
        cells = lines[number].split(",")
        cells[at] = repr(float(cells[at]) + error)
        lines[number] = ",".join(cells)
    table.write_text("\n".join([first, *lines, ""]), encoding="utf-8")


def test_wrong_readings_are_left_out_of_the_extended_job(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "hall"
    assert run(["init", str(folder), "--sample", "laboratory-effects"]) == 0
    job = folder / "jobs/hall.yaml"
    spoilt(folder / "data/lengths.csv", "length_mm", [40, 133], 0.03)
    assert run(["diagnose", str(job)]) == 0
    shown = capsys.readouterr().out
    assert "`outliers: remove` leaves wrong readings out" in shown
    assert re.search("next: .* extended by the named effects and with `outliers: remove`", shown)
    extended = job.with_name("hall.extended.yaml")
    assert "\noutliers: remove\n" in extended.read_text(encoding="utf-8")
    assert run(["multilaterate", str(extended)]) == 0
    shown = capsys.readouterr().out
    assert float(re.search(r"sigma0 ([\d.]+)", shown)[1]) < 1.1  # type: ignore[index]
    again = carry_out(load(extended))
    assert again.verdict == "clean" and len(again.outliers) == 2
    assert run(["diagnose", str(extended)]) == 0
    assert "The job has `outliers: remove`, which leaves wrong readings out.\n" in capsys.readouterr().out
    assert write_extended(load(extended), again) is None


def test_an_estimated_noise_is_diagnosed_as_the_job_states_it() -> None:
    """Readings that a job leaves out would make it several times as large."""
    rng = np.random.default_rng(8)
    job = simulated(rng, 8, 0.0)
    table = job.files.observations
    assert table is not None
    wrong = rng.random(len(table)) < 0.01
    job = replace(
        job,
        settings=replace(job.settings, noise="estimated", outliers="remove"),
        files=replace(job.files, observations=table.changed({"u": table.numbers("u") + 40 * SIGMA * wrong})),
    )
    rest = calibrate_camera.diagnosed(job)
    (group,) = rest.model.readings
    assert group.observations.count == len(table)
    np.testing.assert_allclose(group.observations.sigma, SIGMA, rtol=0.1)
    found = diagnose(rest)
    assert len(found.outliers) == wrong.sum() and found.noise.ratio == pytest.approx(1, abs=0.05)


LENGTHS = "noise: {constant: 0.1 um, proportional: 0.1 um/m}"
CASES = {
    "laboratory-effects": ("hall", "lengths.csv", "length_mm", LENGTHS, LENGTHS.replace("}", ", model: estimated}")),
    "hall-trackers": ("hall", "readings.csv", "d_mm", "datum:", "noise: estimated\ndatum:"),
}


@pytest.mark.parametrize("sample", CASES)
def test_lengths_are_diagnosed_in_the_noise_of_those_that_the_job_keeps(sample: str, tmp_path: Path) -> None:
    name, table, column, old, new = CASES[sample]
    assert run(["init", str(tmp_path / "lab"), "--sample", sample]) == 0
    path, noise = tmp_path / f"lab/jobs/{name}.yaml", []
    path.write_text(path.read_text(encoding="utf-8").replace(old, f"outliers: remove\n{new}"), encoding="utf-8")
    for error in (0.0, 1.0):
        spoilt(tmp_path / "lab/data" / table, column, [40, 133], error)
        groups = adjusted_job_of(load(path)).model.readings
        noise.append(np.median(np.concatenate([group.observations.sigma.ravel() for group in groups])))
    assert noise[1] == pytest.approx(noise[0], rel=0.2)
