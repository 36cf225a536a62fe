"""One small job of each kind, from the command line: the result holds the truth that its readings were made from."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import SAMPLES
from simulated.castings import casting
from simulated.network import network
from tasks.calibrate_machine.test_commands import STANDSTILL
from tasks.shared.images import small_jobs

from benchmarks.coverage import PART, TRUE_LENS
from benchmarks.projects.small_jobs import SIMULATED
from metrocli.formats import hdf5
from metrocli.tasks import KINDS

Metrocli = Callable[..., Any]
LARGEST = 5.0
"""Standard uncertainties that an estimate may be off"""


def made(job: Path, metrocli: Metrocli) -> dict[str, float]:
    """Simulate the readings of a job, put them into their place, and return the truth."""
    assert metrocli("simulate", job, "--seed", 1, "--out", job.parent / "made").code == 0
    for file in (job.parent / "made").glob("*.csv"):
        shutil.copy(file, job.parent)
    found: dict[str, float] = json.loads((job.parent / "made" / "truth.json").read_text())
    return found


def carried_out(job: Path, kind: str, metrocli: Metrocli) -> dict[str, Any]:
    ran = metrocli(kind, job, "--json")
    assert ran.code == 0, ran.err
    found: dict[str, Any] = json.loads(ran.out)["estimates"]
    return found


def assert_true(found: dict[str, Any], truth: dict[str, float]) -> None:
    off = {name: abs(found[name]["value"] - truth[name]) / found[name]["std"] for name in found if name in truth}
    assert off and max(off.values()) < LARGEST, off


def calibrate_camera(folder: Path, metrocli: Metrocli) -> None:
    found = carried_out(small_jobs.board(folder), "calibrate-camera", metrocli)
    assert_true(found, TRUE_LENS)


def align_part(folder: Path, metrocli: Metrocli) -> None:
    job = small_jobs.turned(folder)
    truth = made(job, metrocli)
    assert (truth["x"], truth["gamma_s"]) == (PART.x, 1e-3)
    assert_true(carried_out(job, "align-part", metrocli), truth)


def multilaterate(folder: Path, metrocli: Metrocli) -> None:
    """In a free network places follow the nominal ones: distances of the tracers are what can be compared."""
    shutil.copytree(SAMPLES / "gear-m3d3", folder / "gear")
    job = folder / "gear" / "jobs" / "tip3.yaml"
    job.write_text(job.read_text().replace("../data/lengths.csv", "lengths.csv"))
    truth = made(job, metrocli)
    found = carried_out(job, "multilaterate", metrocli)
    names = sorted({name.partition(".")[0] for name in truth if name.endswith(".x")})

    def place(values: Callable[[str], float], name: str) -> np.typing.NDArray[np.float64]:
        return np.array([values(f"{name}.{axis}") for axis in "xyz"])

    for one, other in combinations(names, 2):
        true, ours = (
            np.linalg.norm(place(values, one) - place(values, other))
            for values in (truth.__getitem__, lambda key: found[key]["value"])
        )
        std = np.linalg.norm([place(lambda key: found[key]["std"], name) for name in (one, other)])
        assert abs(ours - true) < LARGEST * std < 0.1, (one, other)


def locate_launch_unit(folder: Path, metrocli: Metrocli) -> None:
    shutil.copytree(SAMPLES / "xm60-launch-unit", folder / "unit")
    job = folder / "unit" / "jobs" / "table.yaml"
    job.write_text(job.read_text().replace("../data/table.csv", "poses.csv"))
    truth = made(job, metrocli)
    assert_true(carried_out(job, "locate-launch-unit", metrocli), truth)


def selfcal_grid(folder: Path, metrocli: Metrocli) -> None:
    """The machine's errors at the places of the balls, without the rigid motion and the scale that no view shows."""
    job = folder / "job.yaml"
    job.write_text(SIMULATED["selfcal-grid"])
    made(job, metrocli)
    carried_out(job, "selfcal-grid", metrocli)
    result, _ = hdf5.read(folder / "result.h5")
    assert 0.7 < result.statistics["sigma0"] < 1.3
    ours = result.tables["artefact_error"].stacked(("ex", "ey", "ez"))
    rows = [line.split(",") for line in (folder / "made" / "true_artefact_error.csv").read_text().splitlines()]
    at = [next(i for i, head in enumerate(rows[0]) if head.startswith(name)) for name in ("ex", "ey", "ez")]
    true = np.array([[float(row[column]) for column in at] for row in rows[1:]])
    assert np.abs(ours - true).max() < 0.5 * np.abs(true).max()


def calibrate_machine(folder: Path, metrocli: Metrocli) -> None:
    job = folder / "job.yaml"
    job.write_text(STANDSTILL)
    truth = made(job, metrocli)
    assert_true(carried_out(job, "calibrate-machine", metrocli), truth)


def adjust_network(folder: Path, metrocli: Metrocli) -> None:
    net = network(np.random.default_rng(3))
    job = net.write(folder)
    result = carried_out(job, "adjust-network", metrocli)
    truth = {f"S{i + 1}.{axis}": place[k] for i, place in enumerate(net.places) for k, axis in enumerate("xyz")}
    # the frame is that of the list, to its error of 0.5 mm over the root of 12 points
    assert max(abs(result[name]["value"] - value) for name, value in truth.items()) < 1.0


def fit_part(folder: Path, metrocli: Metrocli) -> None:
    """All points get the minimum, and the pose is within the stock of where the casting was made."""
    one = casting(5)
    found = carried_out(one.write(folder), "fit-part", metrocli)
    pose = np.array([found[name]["value"] for name in ("x", "y", "z", "alpha", "beta", "gamma")])
    assert np.abs(pose[:3] - one.pose[:3]).max() < 5.0
    assert one.overstock_at(pose).min() > 0.5 - 1e-6


def fit_points(folder: Path, metrocli: Metrocli) -> None:
    """Points turned by 0.5 rad about z and shifted."""
    rng = np.random.default_rng(8)
    nominal, turn = rng.uniform(-500, 500, (8, 3)), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    turn = np.cos(0.5) * np.eye(3) + np.sin(0.5) * turn + (1 - np.cos(0.5)) * np.diag([0.0, 0.0, 1.0])
    measured = (nominal - [10.0, 20.0, 30.0]) @ turn + rng.normal(0, 0.01, nominal.shape)
    for name, points in (("nominal", nominal), ("measured", measured)):
        rows = [f"P{i},{x!r},{y!r},{z!r}" for i, (x, y, z) in enumerate(points.tolist())]
        (folder / f"{name}.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm", *rows]) + "\n")
    job = folder / "job.yaml"
    job.write_text(
        "metrocli: 1\njob: fit-points\ninputs: {points: measured.csv, nominal: nominal.csv}\n"
        "noise: 0.01 mm\noutput: fit.h5\n"
    )
    assert_true(carried_out(job, "fit-points", metrocli), {"x": 10.0, "y": 20.0, "z": 30.0, "gamma": 0.5})


def report_uncertainty(folder: Path, metrocli: Metrocli) -> None:
    job = folder / "job.yaml"
    job.write_text(
        "metrocli: 1\njob: report-uncertainty\n"
        "quantities: {a: {value: 30 mm, std: 3 um}, b: {value: 40 mm, std: 4 um}}\n"
        'measurands: {c: {model: "sqrt(a**2 + b**2)", unit: mm}}\nmonte_carlo: {trials: 10000, seed: 1}\noutput: u.h5\n'
    )
    found = carried_out(job, "report-uncertainty", metrocli)["c"]
    assert found["value"] == pytest.approx(50.0)
    assert found["std"] == pytest.approx(np.hypot(3e-3 * 30, 4e-3 * 40) / 50, rel=1e-6)


JOBS = (
    calibrate_camera,
    align_part,
    multilaterate,
    locate_launch_unit,
    selfcal_grid,
    calibrate_machine,
    adjust_network,
    fit_part,
    fit_points,
    report_uncertainty,
)


def test_each_kind_has_a_small_job() -> None:
    assert {job.__name__.replace("_", "-") for job in JOBS} == set(KINDS)


@pytest.mark.parametrize("job", JOBS, ids=lambda job: job.__name__)
def test_a_small_job_finds_the_truth(job: Callable[[Path, Metrocli], None], tmp_path: Path, metrocli: Metrocli) -> None:
    job(tmp_path, metrocli)
