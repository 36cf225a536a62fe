"""Features through points of a file: against scipy, stated uncertainties, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from simulated.features import cloud

from metrocli.tasks.shared.features.ideal import IdealFeature

Array = npt.NDArray[np.float64]
Metrocli = Callable[..., Any]
JOB = "metrocli: 1\njob: fit-points\ninputs: {points: points.csv}\nnoise: 3 um\noutput: f.h5\n"
TURN, SHIFT = Rotation.from_euler("xyz", [0.3, -1.1, 2.4]), np.array([120.0, -40.0, 900.0])


def listed(clouds: dict[str, Array], sigma: float | None = None) -> str:
    head = "point,feature,x_mm,y_mm,z_mm" + (",sigma_mm" if sigma else "")
    lines = [
        f"{name}{i},{name},{x:.12g},{y:.12g},{z:.12g}" + (f",{sigma}" if sigma else "")
        for name, points in clouds.items()
        for i, (x, y, z) in enumerate(points.tolist())
    ]
    return "\n".join([head, *lines]) + "\n"


def estimates(metrocli: Metrocli, folder: Path, job: str, points: str, code: int = 0) -> dict[str, Any]:
    (folder / "job.yaml").write_text(job)
    (folder / "points.csv").write_text(points)
    ran = metrocli("fit-points", folder / "job.yaml", "--json", "--force")
    assert ran.code == code, ran.err
    return dict(json.loads(ran.out)["estimates"])


def cylinder(points: Array) -> tuple[Array, Array]:
    """Place nearest to the middle, axis and radius by scipy, and their covariance for a unit noise of coordinates."""

    def numbers(p: Array) -> Array:
        axis = np.array([p[2], p[3], 1.0]) / np.sqrt(p[2] ** 2 + p[3] ** 2 + 1)
        at = np.array([p[0], p[1], 0.0])
        return np.concatenate([at + axis * ((points.mean(axis=0) - at) @ axis), axis, [p[4]]])

    def off(p: Array) -> Array:
        *_, axis, radius = numbers(p)[:3], numbers(p)[3:6], p[4]
        away = points - [p[0], p[1], 0.0]
        return np.asarray(np.linalg.norm(np.cross(away, axis), axis=1) - radius)

    found = least_squares(off, [*points.mean(axis=0)[:2], 0, 0, 20.0], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return numbers(found.x), np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))


def test_a_cylinder_is_that_of_scipy_with_its_uncertainty(tmp_path: Path, metrocli: Metrocli) -> None:
    points = cloud(IdealFeature.CYLINDER, 40, 0.004, np.random.default_rng(5), np.array([0.1, -0.05, 1.0]))
    found = estimates(metrocli, tmp_path, JOB + "features: {bore: cylinder}\n", listed({"bore": points}))
    numbers, std = cylinder(points)
    values = [found[f"bore.{name}"]["value"] for name in ("x", "y", "z", "i", "j", "k", "radius")]
    sign = np.sign(values[5] * numbers[5])
    assert np.abs(values - numbers * [1, 1, 1, sign, sign, sign, 1]).max() < 1e-8
    assert found["bore.radius"]["std"] == pytest.approx(0.003 * std[4], rel=1e-6)


SLOW = (IdealFeature.CYLINDER, IdealFeature.CONE, IdealFeature.SPHERE)
"""Shapes whose fit begins from many directions"""


@pytest.mark.alike
@pytest.mark.parametrize(
    "shape", [pytest.param(one, marks=pytest.mark.slow if one in SLOW else ()) for one in IdealFeature]
)
def test_stated_uncertainties_hold_for_declared_and_for_estimated_noise(shape: IdealFeature, tmp_path: Path) -> None:
    """40 measurements of points without form: z of all numbers is about 1; direction and place have other units."""
    from metrocli.nodes import Node, Source
    from metrocli.settings import LocatedValue
    from metrocli.table import Table
    from metrocli.tasks.fit_points.features import features_alone
    from metrocli.tasks.shared.features.requested import requested_features

    rng, true = np.random.default_rng(8), cloud(shape, 30, 0.0, np.random.default_rng(3))
    node = Node("scalar", Source("job.yaml", (), Path()), "features.f")
    for noise in (0.01, "estimated"):
        values, stds = [], []
        for _ in range(40):
            columns = dict(zip("xyz", (true + rng.normal(0, 0.01, true.shape)).T, strict=True))
            names = {"point": np.array([f"P{i}" for i in range(30)]), "feature": np.array(["f"] * 30)}
            table = Table(names | columns, dict.fromkeys("xyz", "mm"))
            wanted = requested_features({"f": LocatedValue(str(shape), node)}, table, "points")
            result = features_alone(wanted, table, noise)
            numbers = [one for one in result.estimates if not one.name.endswith((".form", ".i", ".j", ".k"))]
            values.append([one.value for one in numbers])
            stds.append([one.std for one in numbers])
        z = (np.array(values) - np.mean(values, axis=0)) / stds
        assert 0.8 < np.sqrt((z**2).sum() / (39 * z.shape[1])) < 1.2


def test_features_are_in_the_frame_of_the_nominal_points(tmp_path: Path, metrocli: Metrocli) -> None:
    rng = np.random.default_rng(9)
    at, unit = rng.uniform(-300, 300, (6, 3)), rng.normal(size=(20, 3))
    ball = [10.0, 20.0, 30.0] + 12.5 * unit / np.linalg.norm(unit, axis=1)[:, None]
    measured = {"": TURN.apply(at) + SHIFT, "ball": TURN.apply(ball) + SHIFT}
    text = listed(measured, 0.005).replace(",,", ",,", 1)
    lines = [line if not line.startswith(tuple("0123456789")) else f"R{line}" for line in text.splitlines()]
    (tmp_path / "nominal.csv").write_text(
        "point,x_mm,y_mm,z_mm,sigma_mm\n" + "".join(f"R{i},{x},{y},{z},0\n" for i, (x, y, z) in enumerate(at.tolist()))
    )
    job = JOB.replace("points.csv}", "points.csv, nominal: nominal.csv}") + "features: {ball: sphere}\n"
    found = estimates(metrocli, tmp_path, job, "\n".join(lines) + "\n")
    assert [found[f"ball.{name}"]["value"] for name in ("x", "y", "z", "radius")] == pytest.approx(
        [10, 20, 30, 12.5], abs=1e-6
    )
    # six points that shift the frame by 5/sqrt(6) um, and turn it, beside 20 points of the ball
    assert found["ball.x"]["std"] > 0.005 / np.sqrt(6) > found["ball.radius"]["std"]
    with h5py.File(tmp_path / "f.h5") as result:
        covariance = result["covariance"][:]
    assert covariance.shape == (len(found), len(found)) and np.linalg.eigvalsh(covariance).min() > -1e-12
    names = list(found)
    shift, ball_x = covariance[names.index("x"), names.index("ball.x")], covariance[names.index("x"), names.index("x")]
    assert shift != 0 and abs(shift) < 100 * ball_x


def test_features_keep_their_own_sigma_where_the_fit_estimates_its_noise(tmp_path: Path, metrocli: Metrocli) -> None:
    """Eight places fit to 0.1 mm; the ball beside them is measured to 5 um, and its radius knows nothing of the fit."""
    rng = np.random.default_rng(9)
    at, unit = rng.uniform(-300, 300, (8, 3)), rng.normal(size=(20, 3))
    ball = [10.0, 20.0, 30.0] + 12.5 * unit / np.linalg.norm(unit, axis=1)[:, None]
    rough = TURN.apply(at) + SHIFT + rng.normal(0, 0.1, at.shape)
    lines = listed({"ball": TURN.apply(ball) + SHIFT}, 0.005)
    lines += "".join(f"R{i},,{x},{y},{z},\n" for i, (x, y, z) in enumerate(rough.tolist()))
    (tmp_path / "nominal.csv").write_text(
        "point,x_mm,y_mm,z_mm\n" + "".join(f"R{i},{x},{y},{z}\n" for i, (x, y, z) in enumerate(at.tolist()))
    )
    job = JOB.replace("noise: 3 um\n", "") + "features: {ball: sphere}\n"
    alone = estimates(metrocli, tmp_path, job, lines)["ball.radius"]["std"]
    after = job.replace("points.csv}", "points.csv, nominal: nominal.csv}").replace("f.h5", "g.h5")
    assert estimates(metrocli, tmp_path, after, lines)["ball.radius"]["std"] == pytest.approx(alone, rel=1e-6)


@pytest.mark.parametrize(
    ("features", "code", "words"),
    [
        ("{bore: cylinder}", 0, ""),
        ("{bore: cylinder}\nrequire: {bore.form: '< 1 nm'}", 6, "NOT met"),
        ("{boar: cylinder}", 3, "did you mean 'bore'?"),
        ("{}", 3, "`features` to lay through the points"),
        ("{bore: plane, few: cone}", 3, "expected 6 or more for a cone"),
        ("{row: plane}", 4, "the 5 points do not determine a plane"),
        ("{few: circle}\nnoise: estimated", 4, "do not show their noise"),
        ("{bore: cylinder}\nscale: true", 3, "a scale needs `nominal` points"),
        ("{bore: {shape: cylinder, fit: minimum-zones}}", 3, "did you mean 'minimum-zone'?"),
    ],
)
def test_what_is_refused(features: str, code: int, words: str, tmp_path: Path, metrocli: Metrocli) -> None:
    rng = np.random.default_rng(2)
    clouds = {
        "bore": cloud(IdealFeature.CYLINDER, 20, 0.004, rng),
        "few": cloud(IdealFeature.CIRCLE, 3, 0.0, rng),
        "row": np.linspace(0, 1, 5)[:, None] * [100.0, 20, 5],
    }
    job = JOB.replace("noise: 3 um\n", "") if "noise" in features else JOB
    (tmp_path / "job.yaml").write_text(job + f"features: {features}\n")
    (tmp_path / "points.csv").write_text(listed(clouds))
    ran = metrocli("fit-points", tmp_path / "job.yaml")
    assert ran.code == code, ran.err
    assert words in " ".join((ran.err + ran.out).split())


def test_a_circle_that_is_calculated_has_no_noise(tmp_path: Path, metrocli: Metrocli) -> None:
    angles = np.linspace(0, 5, 9)
    circle = np.column_stack([7 + 10 * np.cos(angles), 10 * np.sin(angles), np.full(9, 3.0)])
    rows = [f"P{i},c,{x!r},{y!r},{z!r}" for i, (x, y, z) in enumerate(circle.tolist())]
    (tmp_path / "job.yaml").write_text(JOB.replace("noise: 3 um\n", "") + "features: {c: circle}\n")
    (tmp_path / "points.csv").write_text("\n".join(["point,feature,x_mm,y_mm,z_mm", *rows]) + "\n")
    ran = metrocli("fit-points", tmp_path / "job.yaml")
    assert ran.code == 0 and "nothing shows their noise, so no uncertainty is stated" in ran.out
    assert "e-" not in ran.out
