"""The model spline: a shape that no polynomial has is found and its size with it; without a shape there is none."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import yaml
from scipy.interpolate import BSpline
from scipy.optimize import least_squares

from metrocli.arrays import Array
from metrocli.diagnosis.evidence.parts import SCATTER
from metrocli.diagnosis.linear.linearised import linearised
from metrocli.diagnosis.noise import DECLARED_SIGMA, variance_groups
from metrocli.diagnosis.rounds import searched
from metrocli.instruments.lenses.distortion import undistort
from metrocli.project.diagnosed import adjusted_job_of, carry_out, write_extended
from metrocli.project.job import load
from metrocli.tasks.calibrate_camera.shape.spline import Evidence, likely

Metrocli = Callable[..., Any]
SIZE = (960, 720)
MATRIX, DISTORTION = np.array([[750.0, 0, 485], [0, 750, 350], [0, 0, 1]]), np.array([-0.2, 0.08, 3e-4, -2e-4])
BOARD = np.array([[25.0 * x, 25.0 * y, 0.0] for y in range(7) for x in range(10)])
NONE = np.zeros(3)
JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {observations: obs.csv, targets: targets.csv}
camera: {image_size: [960, 720], model: spline}
noise: estimated
output: camera.h5
"""


def bump(uv: Array) -> Array:
    """A shift of about 0.4 px that no polynomial of the lens has."""
    wave = np.stack([np.sin(uv[:, 1] / 80), np.cos(uv[:, 0] / 100)], axis=1) * 0.25
    hill = np.exp(-((uv - [300, 450]) ** 2).sum(axis=1, keepdims=True) / 2 / 100**2)
    return wave + hill * (uv - [300, 450]) / 110


def job(folder: Path, shaped: bool, tilt: tuple[float, float] = (0.0, 0.0)) -> Path:
    rng, rows, number = np.random.default_rng(6), ["image,target,u_px,v_px"], 0
    while number < 10:
        place = np.array([rng.uniform(-110, 110), rng.uniform(-80, 80), rng.uniform(240, 380)])
        points = (BOARD - BOARD.mean(axis=0)) @ cv2.Rodrigues(rng.normal(size=3) * 0.4)[0].T + place
        uv = cv2.projectPoints(points, NONE, NONE, MATRIX, np.array([*DISTORTION, *np.zeros(8), *tilt]))[0][:, 0]
        uv = uv + shaped * bump(uv) + rng.normal(size=uv.shape) * 0.1
        inside = np.flatnonzero(((uv > 0) & (uv < np.array(SIZE) - 1)).all(axis=1))
        if len(inside) > 45:
            rows += [f"v{number},{j},{float(uv[j, 0])},{float(uv[j, 1])}" for j in inside]
            number += 1
    listed = [f"{j},{x},{y},{z}" for j, (x, y, z) in enumerate(BOARD)]
    (folder / "obs.csv").write_text("\n".join(rows))
    (folder / "targets.csv").write_text("\n".join(["target,x_mm,y_mm,z_mm", *listed]))
    (folder / "job.yaml").write_text(JOB)
    return folder / "job.yaml"


def splined(table: Array, uv: Array) -> Array:
    """The shift by SciPy's splines."""
    found = []
    axes = [np.unique(table[name]) for name in ("u", "v")]
    parts = [
        BSpline.design_matrix(x.clip(0, n - 1 - 1e-9), a[0] + (a[1] - a[0]) * (np.arange(len(a) + 4) - 2), 3).toarray()
        for a, x, n in zip(axes, uv.T, SIZE, strict=True)
    ]
    for name in ("du", "dv"):
        grid = table[name].reshape(len(axes[1]), len(axes[0]))
        found.append(np.einsum("na,nb,ba->n", parts[0], parts[1], grid))
    return np.stack(found, axis=1)


def off(result: Path) -> float:
    """Rms distance [px] of the found from the true image of directions, after the best rotation."""
    grid = np.stack(np.meshgrid(np.linspace(50, 909, 20), np.linspace(50, 669, 16)), axis=-1).reshape(-1, 2)
    flat = cv2.undistortPoints(grid[:, None], MATRIX, DISTORTION)[:, 0]  # near enough: any directions will do
    seen = np.column_stack([flat, np.ones(len(flat))])
    truth = cv2.projectPoints(seen, NONE, NONE, MATRIX, DISTORTION)[0][:, 0]
    truth = truth + bump(truth)
    with h5py.File(result) as file:
        lens = {row["parameter"].decode(): row["value"] for row in file["camera"][:]}
        table = file["lens_shape"][:] if "lens_shape" in file else None
    matrix = np.array([[lens["f"], 0, lens["cx"]], [0, lens["f"], lens["cy"]], [0, 0, 1]])
    shift = np.array([lens[name] for name in ("k1", "k2", "p1", "p2")])

    def gap(turn: Array) -> Array:
        at = cv2.projectPoints(seen @ cv2.Rodrigues(turn)[0].T, NONE, NONE, matrix, shift)[0][:, 0]
        return (at + (0 if table is None else splined(table, at)) - truth).ravel()

    return float(np.sqrt(2 * (least_squares(gap, np.zeros(3)).fun ** 2).mean()))


def test_a_shape_is_found(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("calibrate-camera", job(tmp_path, shaped=True))
    assert ran.code == 0, ran.err
    assert "shape of the lens beside its base" in ran.out
    noise = float(re.findall(r"noise of an image coordinate: ([0-9.]+) px", ran.out)[0])
    assert noise == pytest.approx(0.1, rel=0.05)
    assert off(tmp_path / "camera.h5") < 0.15  # 0.07; without the shape 0.55
    ran = metrocli("export", tmp_path / "camera.h5", "--to", "kalibr")
    assert ran.code == 3 and "no model of kalibr is within 0.05 px of this lens" in ran.err


def test_diagnose_names_a_shape(tmp_path: Path) -> None:
    path = job(tmp_path, shaped=True)
    path.write_text(JOB.replace(", model: spline", "").replace("estimated", "0.1 px"))
    _, state = searched(adjusted_job_of(load(path)))
    names = [state.measurement.scatters[one.key[0]][0].name for one in state.random if one.kind == SCATTER]
    assert names == ["lens-shape"] and state.variance == pytest.approx(1.0, rel=0.2)


def test_diagnose_names_a_tilted_sensor(tmp_path: Path) -> None:
    tilt = (np.radians(2.5), np.radians(-3.0))
    path = job(tmp_path, shaped=False, tilt=tilt)
    path.write_text(JOB.replace(", model: spline", "").replace("estimated", "0.1 px"))
    found = carry_out(load(path), quick=True)
    (finding,) = found.findings
    assert finding.effect.alternative.effect.name == "sensor-tilt"
    for size, true in zip(finding.sizes, tilt, strict=True):
        assert abs(size.value - true) < 4 * size.std < abs(true)


def test_a_place_that_is_the_image_of_nothing_has_no_direction() -> None:
    y, x = np.mgrid[-2:2.05:0.1, -2:2.05:0.1].reshape(2, -1)
    seen = np.stack(undistort(x, y, {"k1": -0.2, "k2": 0.08, "k3": 0.3, "tau_x": 0.06, "tau_y": 0.05}))
    assert 0 < np.isnan(seen[0]).sum() < 0.5 * len(x)


def test_a_job_with_a_shape_of_stated_size_has_it(tmp_path: Path, metrocli: Metrocli) -> None:
    path = job(tmp_path, shaped=True)
    path.write_text(JOB.replace(", model: spline", "") + "effects: [{name: lens-shape, std: 0.5 px}]\n")
    ran = metrocli("calibrate-camera", path)
    assert ran.code == 0 and off(tmp_path / "camera.h5") < 0.15  # as with the spline; without 0.55
    adjusted = adjusted_job_of(load(path))
    given = [name for kind, name, _ in variance_groups(adjusted, linearised(adjusted.model)) if kind == DECLARED_SIGMA]
    assert any("lens-shape" in name for name in given), (
        "its stated size may be wrong apart from the noise of the corners"
    )


@pytest.mark.slow
def test_a_fisheye_given_as_a_pinhole_is_named_and_extended(tmp_path: Path) -> None:
    rng, rows = np.random.default_rng(4), ["image,target,u_px,v_px"]
    for number in range(9):
        place = np.array([rng.uniform(-90, 90), rng.uniform(-70, 70), rng.uniform(90, 150)])
        points = (BOARD - BOARD.mean(axis=0)) @ cv2.Rodrigues(rng.normal(size=3) * 0.3)[0].T + place
        across, far = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
        ahead = points[:, 2] > 20
        uv = 350 * points[:, :2] * (np.arctan2(across, far) / across)[:, None] + [485, 350]
        uv += rng.normal(size=uv.shape) * 0.1
        inside = np.flatnonzero(ahead & ((uv > 0) & (uv < np.array(SIZE) - 1)).all(axis=1))
        rows += [f"v{number},{j},{float(uv[j, 0])},{float(uv[j, 1])}" for j in inside]
    path = job(tmp_path, shaped=False)
    (tmp_path / "obs.csv").write_text("\n".join(rows))
    path.write_text(JOB.replace("model: spline", "estimate: [f, cx, cy, k1, k2]"))
    found = carry_out(load(path), limit=0.0)
    longer = write_extended(load(path), found)
    assert found.verdict == "mistaken" and longer is not None
    camera = yaml.safe_load(longer.path.read_text())["camera"]
    assert camera == {
        "image_size": [960, 720],
        "model": "fisheye",
        "estimate": ["f", "cx", "cy", "k1", "k2", "k3", "k4"],
    }


@pytest.mark.parametrize(
    ("entry", "told"),
    [("{name: lens-shape}", "std is missing"), ("{name: lens-shape, std: 0.1 px, z: 1 px}", "leave 'z' out")],
)
def test_the_size_of_a_shape_is_stated(entry: str, told: str, tmp_path: Path, metrocli: Metrocli) -> None:
    path = job(tmp_path, shaped=False)
    path.write_text(JOB.replace(", model: spline", "") + f"effects: [{entry}]\n")
    ran = metrocli("calibrate-camera", path)
    assert ran.code == 3 and told in ran.err


def test_without_a_shape_the_base_is_the_result(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("calibrate-camera", job(tmp_path, shaped=False))
    assert ran.code == 0 and "the readings show no shape of the lens" in ran.out


@pytest.mark.alike
@pytest.mark.parametrize("noise_known", [True, False])
def test_the_size_has_the_largest_restricted_likelihood(noise_known: bool) -> None:
    """The likelihood of differences of the readings, from its definition with dense matrices."""
    rng = np.random.default_rng(3)
    other, own = rng.normal(size=(60, 4)), rng.normal(size=(60, 9))
    root = rng.normal(size=(9, 9)) * 0.5
    kernel = root @ root.T + 0.3 * np.eye(9)
    y = other @ rng.normal(size=4) + own @ np.linalg.cholesky(kernel) @ rng.normal(size=9) * 0.8 + rng.normal(size=60)
    null = np.linalg.svd(other)[0][:, 4:].T
    z, e = null @ own, null @ y

    def minus_log(ratio: float) -> float:
        v = np.eye(56) + ratio * z @ kernel @ z.T
        square, size = float(e @ np.linalg.solve(v, e)), float(np.linalg.slogdet(v)[1])
        return (square + size) / 2 if noise_known else (56 * np.log(square / 56) + size) / 2

    found = likely(Evidence(z.T @ z, z.T @ e, float(e @ e), 56, noise_known), [kernel])
    ratios = np.geomspace(1e-3, 1e3, 4001)
    values = np.array([minus_log(ratio) for ratio in ratios])
    best = ratios[values.argmin()]
    v = np.eye(56) + best * z @ kernel @ z.T
    scale = 1.0 if noise_known else float(e @ np.linalg.solve(v, e)) / 56
    assert found.covariance == pytest.approx(best * scale * kernel, rel=0.01)
    assert found.gain == pytest.approx(minus_log(0.0) - values.min(), abs=1e-3)


def test_base_goes_with_spline(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "job.yaml").write_text(JOB.replace("model: spline", "model: opencv, base: fisheye"))
    (tmp_path / "obs.csv").write_text("image,target,u_px,v_px\na,1,2,3\n")
    (tmp_path / "targets.csv").write_text("target,x_mm,y_mm,z_mm\n1,2,3,0\n")
    ran = metrocli("check", tmp_path / "job.yaml")
    assert ran.code == 3 and "write model: spline" in ran.err
