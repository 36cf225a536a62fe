"""`noise: structured`: intervals contain the truth where readings of one image share errors, and the result states it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from benchmarks import halves
from metrocli.diagnosis.diagnose import diagnose
from metrocli.formats import csv
from metrocli.tasks.calibrate_camera import task as calibrate_camera

Metrocli = Callable[..., Any]
JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {observations: obs.csv, targets: targets.csv}
camera: {image_size: [2592, 1944]}
noise: structured
output: r.h5
"""
BUDGET = """metrocli: 1
job: report-uncertainty
inputs: {results: {camera: r.h5}}
measurands: {f: {model: camera.f, unit: px}}
monte_carlo: {trials: 10000, seed: 1}
output: u.h5
"""


@pytest.mark.slow
def test_intervals_contain_the_truth_where_white_noise_does_not() -> None:
    rng, found = np.random.default_rng(81), {"structured": [], "estimated": []}
    for _ in range(40):
        job = halves.simulated(rng, 8, 1.0)
        for noise, inside in found.items():
            inside += halves.inside(calibrate_camera.run(replace(job, settings=replace(job.settings, noise=noise))))
    assert 0.92 <= np.mean(found["structured"]) <= 0.98
    assert np.mean(found["estimated"]) < 0.87


@pytest.mark.slow
def test_a_board_that_is_estimated_too_does_not_vouch_for_the_lens() -> None:
    """Its many coordinates are better known than what the images share of the lens: they have a factor of their own."""
    rng, dof, inside = np.random.default_rng(83), [], list[bool]()
    for _ in range(8):
        job = halves.simulated(rng, 8, 1.0)
        for targets in ("listed", "estimate"):
            result = calibrate_camera.run(
                replace(job, settings=replace(job.settings, noise="structured", targets=targets))
            )
            dof.append(halves.dof_of(result, "f"))
        inside += halves.inside(result)
    assert max(dof) < 4 * 8
    assert np.mean(inside) > 0.93


@pytest.fixture
def measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[int, float], None]:
    """Write the job of a board with a smooth error in each image."""
    monkeypatch.chdir(tmp_path)

    def write(views: int, process: float) -> None:
        job = halves.simulated(np.random.default_rng([82, views]), views, process)
        for name in ("observations", "targets"):
            table = getattr(job.files, name)
            csv.write(Path(f"{'obs' if name == 'observations' else name}.csv"), table)
        Path("job.yaml").write_text(JOB)

    return write


def test_result_and_report_state_the_model_and_the_growth(
    measured: Callable[[int, float], None], metrocli: Metrocli
) -> None:
    measured(9, 2.0)
    text = metrocli("calibrate-camera", "job.yaml").out
    ran = json.loads(metrocli("calibrate-camera", "job.yaml", "--json").out)
    white = json.loads(metrocli("calibrate-camera", "job.yaml", "--set", "noise=estimated", "--json").out)
    names = list(white["estimates"])
    std, less = (np.array([one["estimates"][name]["std"] for name in names]) for one in (ran, white))
    assert [ran["estimates"][name]["value"] for name in names] == [white["estimates"][n]["value"] for n in names]
    growth = float(np.sqrt(np.mean((std / less) ** 2)))
    figures = ran["statistics"]
    assert growth > 1.5 and (std >= less * (1 - 1e-9)).all()
    assert figures["inflation"] == pytest.approx(growth, rel=1e-6)
    assert (figures["noise_model"], figures["clusters"]) == ("cluster-robust over images", 9)
    assert "inflation" not in white["statistics"]
    assert f"cluster-robust over 9 images; standard uncertainties are {growth:.2f} times those for white noise" in text
    metrocli("calibrate-camera", "job.yaml")
    with h5py.File("r.h5") as result:
        assert result["statistics"].attrs["inflation"] == pytest.approx(growth, rel=1e-6)
        assert np.sqrt(np.diag(result["covariance"])) == pytest.approx(std, rel=1e-9)
        assert result["camera"]["std"][:3] == pytest.approx(std[:3], rel=1e-9)
        assert "share" in result["covariance"].attrs["scaling"]


def test_a_budget_takes_the_degrees_of_freedom(measured: Callable[[int, float], None], metrocli: Metrocli) -> None:
    measured(6, 1.0)
    Path("budget.yaml").write_text(BUDGET)
    ran = json.loads(metrocli("calibrate-camera", "job.yaml", "--json").out)
    stated = {one["dof"] for one in ran["estimates"].values()}
    assert len(stated) == 1 and 2 < min(stated) < 40
    budget = json.loads(metrocli("report-uncertainty", "budget.yaml", "--json").out)["estimates"]["f"]
    assert budget["dof"] == pytest.approx(min(stated))
    assert budget["std"] == pytest.approx(ran["estimates"]["f"]["std"], rel=1e-6)


def test_four_images_are_refused(measured: Callable[[int, float], None], metrocli: Metrocli) -> None:
    measured(4, 0.0)
    ran = metrocli("calibrate-camera", "job.yaml")
    assert ran.code == 4 and "4 images are too few" in ran.err and "noise: estimated" in ran.err


def test_what_varies_in_each_image_is_left_unexplained() -> None:
    job = halves.simulated(np.random.default_rng([82, 6]), 6, 4.0)
    found = diagnose(calibrate_camera.diagnosed(replace(job, settings=replace(job.settings, noise=0.05))))
    assert found.left is not None and found.left.depends_on == ("place in the image",)
    assert found.verdict == "unexplained"
    # what is named beside it may be nothing, by its own uncertainty
    assert all(one.effect.level_of_size > 0.05 for one in found.findings)
    # a small structure is let pass, but not beside smooth errors that are larger
    little, alone = replace(found.left, share=0.01), replace(found, findings=())
    assert replace(alone, left=little).verdict == "explained"
    assert replace(alone, left=replace(little, beside=0.08)).verdict == "unexplained"


@pytest.mark.slow
def test_diagnose_proposes_it_where_structure_is_left(
    measured: Callable[[int, float], None], metrocli: Metrocli
) -> None:
    measured(6, 4.0)
    Path("job.yaml").write_text(JOB.replace("structured", "0.05 px"))
    found = json.loads(metrocli("diagnose", "job.yaml", "--json").out)
    assert (found["verdict"], found["extended_job"]) == ("unexplained", "job.extended.yaml")
    # the smooth error of each image that was found is in the model itself
    assert "by: image" in Path("job.extended.yaml").read_text()
    assert metrocli("calibrate-camera", "job.extended.yaml").code == 0
    again = json.loads(metrocli("diagnose", "job.extended.yaml", "--json").out)
    assert again["verdict"] in ("clean", "explained") and not again["effects"]


@pytest.mark.slow
def test_diagnose_does_not_propose_it_without_structure(
    measured: Callable[[int, float], None], metrocli: Metrocli
) -> None:
    measured(6, 0.0)
    Path("job.yaml").write_text(JOB.replace("structured", "0.05 px"))
    found = json.loads(metrocli("diagnose", "job.yaml", "--json").out)
    assert (found["verdict"], found["extended_job"]) == ("clean", None)
    assert not Path("job.extended.yaml").exists()
