"""Targets nearer than the focal length: a list in another unit, which neither residuals nor the lens in px show."""

from __future__ import annotations

import numpy as np

from metrocli import units
from metrocli.instruments import camera
from metrocli.instruments.camera import TARGET
from metrocli.tasks.calibrate_camera.problem import Problem
from metrocli.tasks.shared.images.adjustment import Adjusted


def too_near(problem: Problem, adjusted: Adjusted, pixel_size: float | None) -> list[str]:
    """Return why a camera must not be used whose targets are nearer than its focal length: a lens has no image there.

    The distance of the camera [mm] is the median of the views, to the middle of the targets or the origin of the board.
    """
    blocks = adjusted.solution.blocks
    lens = blocks[camera.LENS].named()
    place = blocks[camera.view_name(problem.rig)].values[:, :3]
    seen = blocks[TARGET].values[np.unique(adjusted.group.observations.index[TARGET])]
    middle = np.zeros(3) if problem.rig == "board" else seen.mean(axis=0)
    far = float(np.median(np.linalg.norm(place - middle, axis=1)))
    focal = (pixel_size or 0.0) * float(lens.get("f", lens.get("fx", 0.0)))
    if far >= focal:
        return []
    return [
        f"the targets are {units.sized(far, 'length')} from the camera, nearer than its focal length of "
        f"{units.sized(focal, 'length')}, where a lens has no image: check the unit of the targets, or the pitch, "
        "and pixel_size"
    ]
