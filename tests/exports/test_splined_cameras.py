"""mrcal's splined model there and back: by its formula on scipy's B-splines, by mrcal itself, and in use."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import yaml
from exports.test_cameras import SIZE, mrcal_projects, ours, points, stated, written
from scipy.interpolate import BSpline

from benchmarks.apart import rig
from metrocli.errors import InputError
from metrocli.formats import hdf5
from metrocli.imports.cameras import as_yaml
from metrocli.imports.lines import TextLines

Array = npt.NDArray[np.float64]
Metrocli = Callable[..., Any]
RNG = np.random.default_rng(47)


def spline(at: Array, first: float, step: float, count: int) -> Array:
    """Cubic B-splines (n, count) about knots at equal steps from the first; beyond the inner ones cubics go on."""
    edges = first + step * (np.arange(count + 4) - 2)
    return np.stack([BSpline(edges, row, 3, extrapolate=True)(at) for row in np.eye(count)], axis=1)


def numbers(text: str, key: str) -> Array:
    return np.array(re.search(rf"'{key}'\s*:\s*\[([^\]]*)\]", text)[1].split(","), dtype=float)  # type: ignore[index]


def projected(text: str, seen: Array) -> Array:
    """Return the image points (n, 2) of points (n, 3) by the text of a splined camera."""
    nx, ny, field = map(int, re.findall(r"_Nx=(\d+)_Ny=(\d+)_fov_x_deg=(\d+)", text)[0])
    values = numbers(text, "intrinsics")
    shifts = values[4:].reshape(ny, nx, 2)
    step = 4 * np.tan(np.radians(field) / 4) / (nx - 3)
    u = 2 * seen[:, :2] / (np.linalg.norm(seen, axis=1) + seen[:, 2])[:, None]
    along = [spline(u[:, k], -step * (n - 1) / 2, step, n) for k, n in enumerate((nx, ny))]
    return values[:2] * (u + np.einsum("ni,nj,jia->na", *along, shifts)) + values[2:4]


def inside(uv: Array) -> npt.NDArray[np.bool_]:
    """Whether image points are in the image, as points beyond it have no stated difference."""
    return ((uv >= 0) & (uv <= np.array(SIZE) - 1)).all(axis=1)


@pytest.mark.alike
@pytest.mark.parametrize("name", ["fisheye", "tilted", "skewed"])
def test_a_lens_that_no_other_model_of_mrcal_holds_is_written_as_a_spline(name: str) -> None:
    text, seen = written("mrcal", name), points(name)
    seen = seen[inside(ours(name, seen))]
    assert len(seen) > 300
    gap = np.linalg.norm(projected(text, seen) - ours(name, seen), axis=1)
    rms, largest = stated(text)
    assert gap.max() < 1.1 * largest and 0 < rms < largest <= 0.05


def test_mrcal_projects_a_written_spline_by_the_same_formula(tmp_path: Path) -> None:
    for name, (file, found) in mrcal_projects(tmp_path, ("fisheye", "tilted")).items():
        seen = points(name)
        known = inside(ours(name, seen))
        assert np.abs(found - projected(file.read_text(), seen))[known].max() < 1e-9
        assert np.linalg.norm(found - ours(name, seen), axis=1)[known].max() < 1.1 * stated(file.read_text())[1]


def model(shifts: Array, field: int = 90, focal: str = "500.0, 502.0") -> str:
    """A splined camera of 640 x 480 px with shifts of its knots (rows, columns, 2)."""
    rows, columns, _ = shifts.shape
    kind = f"LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx={columns}_Ny={rows}_fov_x_deg={field}"
    values = ", ".join([focal, "321.5, 238.0", *map(repr, shifts.ravel().tolist())])
    return f"{{\n 'lensmodel': '{kind}',\n 'intrinsics': [ {values} ],\n 'imagersize': [ 640, 480 ],\n}}\n"


def smooth() -> Array:
    """Shifts of a smooth surface: barrel distortion up to 15 px, and some px that no polynomial in use has."""
    x, y = np.meshgrid(np.linspace(-1, 1, 12), np.linspace(-1, 1, 10))
    radial = -0.03 * (x * x + y * y)
    a, b, c = RNG.normal(0, 0.003, (3, 2))
    return np.stack(
        [at * radial + a[k] * x * y + b[k] * np.sin(3 * x) + c[k] * np.cos(2 * x - y) for k, at in enumerate((x, y))],
        axis=-1,
    )


def read(text: str) -> str:
    found = as_yaml(TextLines("their.cameramodel", text.splitlines()))
    assert found is not None
    return found


def test_a_spline_of_mrcal_is_read_within_the_stated_difference() -> None:
    text = model(smooth())
    held = read(text)
    camera, k = yaml.safe_load(held), {}
    for key in ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "s1", "s3"):
        k[key] = float(str(camera.get(key, 0)).split()[0])
    seen = np.column_stack([RNG.uniform(-1, 1, (3000, 2)) * [0.7, 0.55], np.ones(3000)])
    wanted = projected(text, seen)
    seen, wanted = (one[((wanted >= 0) & (wanted <= [639, 479])).all(axis=1)] for one in (seen, wanted))
    tangent = np.hypot(*seen[:, :2].T)
    x, y = (seen[:, :2] * (np.arctan(tangent) / tangent)[:, None]).T
    r2 = x * x + y * y
    radial = 1 + k["k1"] * r2 + k["k2"] * r2**2 + k["k3"] * r2**3 + k["k4"] * r2**4
    base = np.stack(
        [
            k["fx"] * (x * radial + 2 * k["p1"] * x * y + k["p2"] * (r2 + 2 * x * x) + k["s1"] * r2) + k["cx"],
            k["fy"] * (y * radial + k["p1"] * (r2 + 2 * y * y) + 2 * k["p2"] * x * y + k["s3"] * r2) + k["cy"],
        ]
    )
    (nx, ny), sizes = camera["shape"]["knots"], (639, 479)
    steps = [extent / (n - 3) for extent, n in zip(sizes, (nx, ny), strict=True)]
    along = [
        spline(np.clip(base[axis], 0, sizes[axis]), -steps[axis], steps[axis], n) for axis, n in enumerate((nx, ny))
    ]
    shift = [np.einsum("ni,nj,ji->n", *along, np.reshape(camera["shape"][name], (ny, nx))) for name in ("du", "dv")]
    gap = np.hypot(*(base + shift - wanted.T))
    largest = float(re.findall(r"largest difference ([0-9.e-]+) px", held)[0])
    assert len(seen) > 1000 and gap.max() < 1.2 * largest and largest <= 0.05


def test_splines_that_are_no_lens_are_refused() -> None:
    def fault(text: str) -> str:
        with pytest.raises(InputError) as caught:
            read(text)
        return str(caught.value)

    rough = RNG.normal(0, 0.004, (30, 36, 2))
    said = fault(model(rough))
    assert "is not smooth enough" in said and "within 0.05 px" in said
    folded = np.zeros((10, 12, 2))
    folded[..., 0] = np.linspace(3, -3, 12)
    assert "the model folds over" in fault(model(folded))
    assert "has 243 intrinsics" in fault(model(smooth()).replace("500.0, 502.0", "500.0"))
    assert "fx and fy are -500.0 and 502.0" in fault(model(smooth(), focal="-500.0, 502.0"))
    assert "is not known here" in fault(model(smooth()).replace("order=3", "order=2"))


@pytest.mark.slow
def test_a_camera_with_a_shape_goes_through_mrcal_to_a_part(metrocli: Metrocli, tmp_path: Path) -> None:
    """Calibrated with the model spline, written for mrcal and read again; without noise the part is where it was."""
    rig.write_jobs(tmp_path, None, ("wide",))
    assert metrocli("calibrate-camera", tmp_path / "cam.yaml").code in (0, 6)
    ran = metrocli("export", tmp_path / "cam.h5", "--to", "mrcal", "--out", tmp_path, "--accept-doubtful")
    assert ran.code == 0, ran.err
    assert "LENSMODEL_SPLINED_STEREOGRAPHIC" in (tmp_path / "camera.cameramodel").read_text()
    place = {one.name: one.value for one in hdf5.read(tmp_path / "cam.h5")[0].estimates}
    held = {key: f"{place[key]!r} mm" for key in "xyz"}
    held |= {key: f"{place[key]!r} rad" for key in ("alpha", "beta", "gamma")}
    job = yaml.safe_load((tmp_path / "job.yaml").read_text())
    job["inputs"]["camera"] = "camera.cameramodel"
    job["camera"] = {"extrinsics": held}
    (tmp_path / "job.yaml").write_text(yaml.safe_dump(job))
    ran = metrocli("align-part", tmp_path / "job.yaml", "--json")
    assert ran.code == 0, ran.err
    found = {name: one["value"] for name, one in json.loads(ran.out)["estimates"].items()}
    assert found == pytest.approx(rig.TRUTH, abs=0.01)
