"""What `diagnose` finds in a best fit: growth, a wrong axis, a moved point, lists in other units."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

Metrocli = Callable[..., Any]
Array = npt.NDArray[np.float64]
JOB = """metrocli: 1
job: fit-points
inputs: {points: measured.csv, nominal: nominal.csv}
noise: 20 um
output: fit.h5
"""
TURN, SHIFT = Rotation.from_euler("xyz", [0.2, -0.4, 2.1]).as_matrix(), np.array([300.0, -4000.0, 120.0])


def written(folder: Path, change: Callable[[Array], Array], after: Callable[[Array], Array] = np.copy) -> Path:
    """Write the lists of a part that differs from its nominal places, as a machine measures it, and the job."""
    rng = np.random.default_rng(5)
    nominal = rng.uniform([-2000, -1500, -300], [2000, 1500, 900], (12, 3))
    measured = after((change(nominal) - SHIFT) @ TURN + rng.normal(0, 0.02, nominal.shape))
    for name, places in (("measured", measured), ("nominal", nominal)):
        rows = (f"P{i},{x:.4f},{y:.4f},{z:.4f}\n" for i, (x, y, z) in enumerate(places))
        (folder / f"{name}.csv").write_text("point,x_mm,y_mm,z_mm\n" + "".join(rows))
    (folder / "job.yaml").write_text(JOB)
    return folder / "job.yaml"


def moved(nominal: Array) -> Array:
    return nominal + np.outer(np.arange(12) == 3, [0.4, 0.0, -0.3])


def one_axis(measured: Array) -> Array:
    return measured * [1.0, 1.0003, 1.0]


@pytest.mark.alike
@pytest.mark.parametrize(
    ("change", "after", "name", "where", "size"),
    [
        (lambda nominal: nominal * (1 + 2e-4), np.copy, "part-expansion", {}, {"scale": -2e-4}),
        (np.copy, one_axis, "machine-scale", {"axis": "y"}, {"scale": -3e-4}),
        (moved, np.copy, "moved-point", {"point": "P3"}, {"dx": 0.4, "dy": 0.0, "dz": -0.3}),
    ],
)
def test_the_cause_is_named_with_its_size(
    change: Any,
    after: Any,
    name: str,
    where: dict[str, str],
    size: dict[str, float],
    tmp_path: Path,
    metrocli: Metrocli,
) -> None:
    ran = metrocli("diagnose", written(tmp_path, change, after), "--json")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    assert found["verdict"] == "explained" and [one["name"] for one in found["effects"]] == [name]
    assert (found["effects"][0].get("where") or {}) == where
    again = metrocli("fit-points", tmp_path / "job.extended.yaml", "--json")
    assert again.code == 0, again.err
    estimates = json.loads(again.out)["estimates"]
    for parameter, value in size.items():
        given = next(v for key, v in estimates.items() if key.split(".")[-1] == parameter)
        about = 1.0 if name == "part-expansion" else 0.0
        u = given["std"]
        assert abs(given["value"] - about - value) < 4 * u < 0.2, (parameter, given)


def test_a_wrong_scale_and_a_mistaken_point_are_no_wrong_sigma(tmp_path: Path, metrocli: Metrocli) -> None:
    """Nominal places that are exact show no noise with which that of the measured ones could be compared."""
    job = written(tmp_path, lambda nominal: (nominal + np.outer(np.arange(12) == 3, [200, -150, 60])) * 1.05)
    job.write_text(JOB.replace("noise: 20 um\n", ""))
    for name, sigma in (("measured", 0.02), ("nominal", 0)):
        head, *rows = (tmp_path / f"{name}.csv").read_text().splitlines()
        rows = [f"{head},sigma_mm", *(f"{row},{sigma}" for row in rows)]
        (tmp_path / f"{name}.csv").write_text("\n".join(rows) + "\n")
    found = json.loads(metrocli("diagnose", job, "--json").out)
    assert not found["noise"]["apart"] and found["verdict"] == "explained"
    assert {one["name"] for one in found["effects"]} == {"part-expansion", "moved-point"}


def test_higher_orders_of_a_large_effect_get_no_names_where_points_are_few(tmp_path: Path, metrocli: Metrocli) -> None:
    skewed = np.array([[1.0, 0, 0.1], [0, 1, 0], [0, 0, 1]])
    found = json.loads(metrocli("diagnose", written(tmp_path, np.copy, lambda xyz: xyz @ skewed.T), "--json").out)
    assert [one["name"] for one in found["effects"]] == ["machine-squareness"] and found["verdict"] == "explained"


def test_nothing_is_named_without_a_cause(tmp_path: Path, metrocli: Metrocli) -> None:
    assert json.loads(metrocli("diagnose", written(tmp_path, np.copy), "--json").out)["verdict"] == "clean"


@pytest.mark.parametrize(("size", "words"), [(25.4, "in inches"), (304.8, "are in ft")])
def test_a_list_in_another_unit_is_a_mistake_of_a_file(
    size: float, words: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    ran = metrocli("diagnose", written(tmp_path, np.copy, lambda measured: measured / size))
    assert "verdict: mistaken" in ran.out and words in ran.out


def test_features_alone_have_nothing_to_diagnose(tmp_path: Path, metrocli: Metrocli) -> None:
    job = written(tmp_path, np.copy)
    rows = (tmp_path / "measured.csv").read_text().splitlines()
    (tmp_path / "measured.csv").write_text("\n".join([f"{rows[0]},feature", *(f"{row},face" for row in rows[1:])]))
    job.write_text(JOB.replace(", nominal: nominal.csv", "") + "features: {face: plane}\n")
    ran = metrocli("diagnose", job)
    assert ran.code == 3 and "only a best fit can be diagnosed" in ran.err
