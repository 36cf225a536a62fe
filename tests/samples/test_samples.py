"""The sample projects run from images to results that hold the truth their images were rendered from."""

from __future__ import annotations

import contextlib
import io
import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metrocli.geometry.poses import EULER
from metrocli.tasks import KINDS

Metrocli = Callable[..., Any]
SAMPLES = Path(__file__).parents[2] / "sample_projects"
BOUND = 3.5
"""Standard uncertainties that an estimate may be off"""


@pytest.fixture(scope="module")
def spindle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With every sixteenth image of the camera alone: to find the dot in all 200 takes most of the time."""

    def shortened(project: Path) -> None:
        for at, image in enumerate(sorted((project / "cmm/images").glob("*.png"))):
            if at % 16:
                image.unlink()

    return _run("spindle-camera", tmp_path_factory, shortened)


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _run("board-camera", tmp_path_factory)


def _run(
    name: str, tmp_path_factory: pytest.TempPathFactory, change: Callable[[Path], None] = lambda project: None
) -> Path:
    from metrocli.cli.commands import run

    project = tmp_path_factory.mktemp("sample") / name
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        assert run(["init", str(project), "--sample", name]) == 0
        change(project)
        assert run(["run", str(project)]) == 0
    return project


def truth(job: Path) -> dict[str, float]:
    """Return the values of the job's simulation by the name of their estimate."""
    from metrocli.project.job import load

    simulation = load(job).settings.simulation
    if hasattr(simulation, "part"):
        values = {name: getattr(simulation.part, name) for name in EULER}
        return {**values, "gamma_s": simulation.clamping_angle}
    values = dict(simulation.lens.given())
    if simulation.extrinsics is not None:
        values |= {name: getattr(simulation.extrinsics, name) for name in EULER}
    return values


def assert_true(job: Path, result: Path) -> None:
    from metrocli.formats import hdf5

    found, _ = hdf5.read(result)
    true = truth(job)
    assert {estimate.name for estimate in found.estimates} == set(true)
    for estimate in found.estimates:
        assert abs(estimate.value - true[estimate.name]) < BOUND * estimate.std, estimate.name


@pytest.mark.slow
def test_the_board_camera_is_the_true_one(board: Path) -> None:
    assert_true(board / "jobs" / "calibrate.yaml", board / "results" / "camera.h5")


def test_the_spindle_camera_is_the_true_one(spindle: Path) -> None:
    assert_true(spindle / "jobs" / "calibrate.yaml", spindle / "results" / "camera.h5")


def test_the_part_is_where_it_is(spindle: Path) -> None:
    assert_true(spindle / "jobs" / "align.yaml", spindle / "results" / "part.h5")


def test_the_part_is_known_to_some_micrometres(spindle: Path) -> None:
    from metrocli.formats import hdf5

    std = {estimate.name: estimate.std for estimate in hdf5.read(spindle / "results" / "part.h5")[0].estimates}
    assert all(std[name] < 0.02 for name in "xyz")
    assert all(std[name] < 2e-5 for name in ("alpha", "beta", "gamma", "gamma_s"))


def test_a_project_that_ran_is_up_to_date(spindle: Path, metrocli: Metrocli) -> None:
    ran = metrocli("status", spindle)
    assert ran.code == 0
    assert all(line.endswith("up to date") for line in ran.out.splitlines())
    again = metrocli("run", spindle)
    assert again.code == 0
    assert ": ran" not in again.out + again.err


def test_results_are_shown(spindle: Path, metrocli: Metrocli) -> None:
    ran = metrocli("show", spindle / "results" / "part.h5")
    assert ran.code == 0
    assert "gamma_s" in ran.out and "mm/m" in ran.out and "R_P" in ran.out
    summary = json.loads(metrocli("show", spindle / "results" / "camera.h5", "--json").out)
    assert summary["kind"] == "calibrate-camera"
    assert set(summary["estimates"]) == {"f", "cx", "cy", "k1", "k2", "p1", "p2", *EULER}


@pytest.mark.parametrize(
    ("sample", "jobs"),
    [
        pytest.param(
            "otf-tracker", {f"feed-{feed}": 12 for feed in (2500, 5000, 10000, 15000)}, marks=pytest.mark.slow
        ),
        ("machine-lengths", {"lengths": 18, "one-tool": 12}),
    ],
)
def test_the_machine_is_the_true_one(
    sample: str, jobs: dict[str, int], tmp_path_factory: pytest.TempPathFactory
) -> None:
    import csv

    from metrocli.formats import hdf5

    project = _run(sample, tmp_path_factory)
    true: dict[str, list[float]] = {}
    with (project / "data" / "true_errors.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            true.setdefault(row["error"], []).append(float(row["value_mm"] or row["turn_rad"]))
    for job, count in jobs.items():
        found, _ = hdf5.read(project / "results" / f"{job}.h5")
        status = dict(zip(found.tables["errors"].texts("error"), found.tables["errors"].texts("status"), strict=True))
        determined = [name for name in true if status[name] == "determined"]
        assert len(determined) == count
        off = [np.subtract(found.tables[f"tables/{name}"].numbers("value"), true[name]) for name in determined]
        std = [np.maximum(found.tables[f"tables/{name}"].numbers("std"), 1e-12) for name in determined]
        scores = np.concatenate([a / b for a, b in zip(off, std, strict=True)])
        assert np.abs(scores).max() < 4.5
        assert np.sqrt((scores**2).mean()) < 1.3


FIVE_AXES = {
    "EY0A": 34.781e-3, "EZ0A": 25.604e-3, "EB0A": -11.203e-6, "EC0A": 22.499e-6,
    "EX0C": -22.865e-3, "EY0C": 7.148e-3, "EA0C": -130.128e-6, "EB0C": 161.006e-6,
}  # fmt: skip
"""Locations with which the readings of `five-axis` were simulated"""
CRASH = {"dy": 4.2e-3, "dz": -2.6e-3}


def test_the_axes_and_the_crash_are_the_true_ones(tmp_path_factory: pytest.TempPathFactory, metrocli: Metrocli) -> None:
    from metrocli.formats import hdf5

    project = _run("five-axis", tmp_path_factory)
    whole, after = (hdf5.read(project / "results" / f"{name}.h5")[0] for name in ("whole-run", "after"))
    truth_after = FIVE_AXES | {"EY0A": FIVE_AXES["EY0A"] + CRASH["dy"], "EZ0A": FIVE_AXES["EZ0A"] + CRASH["dz"]}
    with_crash = FIVE_AXES | {f"axis-jump.a.{name}": value for name, value in CRASH.items()}
    for found, true in ((whole, with_crash), (after, truth_after)):
        assert {one.name for one in found.estimates} == set(true)
        assert all(abs(one.value - true[one.name]) < BOUND * one.std for one in found.estimates)
    checked = metrocli("verify", project / "results" / "after.h5", project / "data" / "check.csv", "--json")
    assert json.loads(checked.out)["rms"] < 1.25 * 2e-3 * np.sqrt(3)


def test_the_part_has_a_table_of_maxima(spindle: Path) -> None:
    from metrocli.cli.summary import summary
    from metrocli.formats import hdf5

    path = spindle / "results" / "uncertainty.h5"
    result, record = hdf5.read(path)
    assert [Path(item.path).name for item in record.inputs] == ["part.h5"]
    found = summary(result, record, path)["estimates"]
    budget = result.tables["budget"]
    warm = [
        std
        for name, std in zip(budget.texts("contributor"), budget.numbers("std"), strict=True)
        if name == "temperature"
    ]
    assert warm == pytest.approx([0.00953, 0.00635, 0.00318], abs=1e-5)
    for axis in "xyz":
        assert 0 < found[axis]["U_pointwise"] <= found[axis]["U"] < 0.05
        assert found[axis]["tolerance"]["capable"]


@pytest.fixture(scope="module")
def gauge(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _run("gauge-block", tmp_path_factory)


def test_the_gauge_block_is_that_of_the_guides(gauge: Path) -> None:
    """JCGM 100, H.1: u 32 nm, 16 degrees of freedom, U99 93 nm, 34 nm to the second order; JCGM 101, 9.5: 36, [745, 932]."""
    from metrocli.formats import hdf5

    first, _ = hdf5.read(gauge / "results" / "gum.h5")
    length = first.details["l"]
    assert first.estimates[0].value == pytest.approx(50.000838, abs=6e-7)
    assert first.estimates[0].std == pytest.approx(32e-6, abs=0.5e-6)
    assert length["dof"] == pytest.approx(16.75, abs=0.06)
    assert length["U"] == pytest.approx(93e-6, abs=0.7e-6)
    assert length["second_order"]["std"] == pytest.approx(34e-6, abs=0.5e-6)
    second, _ = hdf5.read(gauge / "results" / "supplement.h5")
    trials = second.details["deviation"]["mc"]
    assert (trials["mean"], trials["std"]) == pytest.approx((838, 36), abs=0.5)
    assert trials["shortest"] == pytest.approx([745, 932], abs=2.5)
    assert second.details["deviation"]["gum_valid"] is False


@pytest.mark.slow
def test_what_happened_to_the_gear_is_found(tmp_path: Path, metrocli: Metrocli) -> None:
    """The lengths of tip 4 were simulated with a jump of LT2 of 1.5 um at 3000 s."""
    home = tmp_path / "gear"
    metrocli("init", home, "--sample", "gear-m3d3")
    found = json.loads(metrocli("diagnose", home / "jobs" / "tip4.yaml", "--json").out)
    assert found["verdict"] == "explained"
    (effect,) = found["effects"]
    assert (effect["name"], effect["where"]) == ("dead-path-jump", {"tracer": "LT2"})
    step = effect["parameters"]["step"]
    assert abs(step["value"] - 1.5e-3) < 2 * step["std"]
    assert effect["gain"]["shown"]
    assert metrocli("multilaterate", home / "jobs" / "tip4.extended.yaml", "--quiet").code == 0
    again = json.loads(metrocli("diagnose", home / "jobs" / "tip4.extended.yaml", "--json").out)
    assert again["verdict"] == "clean"


@pytest.mark.parametrize("name", KINDS)
def test_the_example_of_a_kind_is_a_job_of_its_sample(name: str) -> None:
    from metrocli.cli.help import EXAMPLES
    from metrocli.project.job import kind_of_job

    sample, typed = EXAMPLES[name]
    command, job = typed.removeprefix("metrocli ").split()
    assert command == kind_of_job(SAMPLES / sample / job) == name


@pytest.mark.slow
def test_the_examples_of_the_help_can_be_typed(
    tmp_path: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch
) -> None:
    from metrocli.cli.help import EXAMPLES

    home = tmp_path / "gear"
    metrocli("init", home, "--sample", "gear-m3d3")
    monkeypatch.chdir(home)
    assert metrocli("run", "--quiet").code == 0
    typed = [example for sample, example in EXAMPLES.values() if sample in ("", "gear-m3d3")]
    for example in typed:
        if not example.startswith("eval"):
            ran = metrocli(*shlex.split(example)[1:])
            assert ran.code == 0, (example, ran.err)
