"""Two cameras differ by what no rotation takes: by brute force with scipy, and by truths that need no computing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.shared.images.calibrated import lens_differences

SIZE = (1280, 960)
LENS = {"f": 1100.0, "cx": 640.0, "cy": 480.0, "k1": -0.1}


def result(**changed: float) -> Result:
    lens = {**LENS, **changed}
    table = Table.of({"parameter [text]": list(lens), "value": np.array([*lens.values()])})
    statistics: dict[str, Any] = {"image_width": SIZE[0], "image_height": SIZE[1], "convention": "forward"}
    return Result("calibrate-camera", "", (), np.zeros((0, 0)), statistics, {"camera": table})


def image(lens: dict[str, float], points: Any) -> Any:
    x, y = points[0] / points[2], points[1] / points[2]
    growth = lens["f"] * (1 + lens["k1"] * (x * x + y * y))
    return np.stack([growth * x + lens["cx"], growth * y + lens["cy"]])


@pytest.mark.parametrize("changed", [{"cx": 645.0}, {"k1": -0.09}, {"f": 1103.0, "cy": 470.0}])
def test_the_difference_is_what_the_best_rotation_leaves(changed: dict[str, float]) -> None:
    (found,) = lens_differences(result(), result(**changed))
    # directions of the first camera, by solving its formula point by point
    flat = (found.uv - [[LENS["cx"]], [LENS["cy"]]]) / LENS["f"]
    near = least_squares(lambda p: ((1 + LENS["k1"] * (p.reshape(2, -1) ** 2).sum(0)) * p.reshape(2, -1) - flat).ravel(), flat.ravel(), jac_sparsity=np.tile(np.eye(flat.shape[1]), (2, 2)), xtol=1e-14, ftol=1e-15, gtol=1e-14)  # fmt: skip
    seen = np.concatenate([near.x.reshape(2, -1), np.ones((1, flat.shape[1]))])
    second = {**LENS, **changed}
    units = seen / np.linalg.norm(seen, axis=0)

    def change(turn: Any) -> Any:
        return image(second, Rotation.from_rotvec(turn).as_matrix() @ seen) - found.uv

    def apart(turn: Any) -> Any:
        # directions of the second camera at the same pixels: their angles are what the rotation makes small
        other = (found.uv - [[second["cx"]], [second["cy"]]]) / second["f"]
        for _ in range(60):
            other = (found.uv - [[second["cx"]], [second["cy"]]]) / second["f"] / (1 + second["k1"] * (other**2).sum(0))
        there = np.concatenate([other, np.ones((1, other.shape[1]))])
        return (Rotation.from_rotvec(turn).as_matrix() @ units - there / np.linalg.norm(there, axis=0)).ravel()

    best = least_squares(apart, np.zeros(3), xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    assert found.change == pytest.approx(change(best), abs=2e-5)
    assert found.largest[0] == pytest.approx(np.hypot(*change(best)).max(), abs=1e-4)


def test_a_shifted_principal_point_is_mostly_a_rotation() -> None:
    (same,), (shifted,) = lens_differences(result(), result()), lens_differences(result(), result(cx=645.0))
    assert same.rms < 1e-9
    assert shifted.rms < 1.5  # of 5 px


def test_cameras_of_other_images_are_not_compared() -> None:
    other = result()
    other.statistics["image_width"] = 640  # type: ignore[index]
    assert lens_differences(result(), other) == []
