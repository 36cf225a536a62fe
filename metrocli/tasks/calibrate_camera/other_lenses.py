"""Other lens models for the same readings: a fisheye that is given as a pinhole is named."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.diagnosis.corrections import Mistake
from metrocli.errors import UndeterminedError
from metrocli.instruments import camera
from metrocli.instruments.lenses.lens import direction
from metrocli.tasks.calibrate_camera.build import build
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.settings import CameraSettings, Files, Settings
from metrocli.tasks.job import Job
from metrocli.tasks.shared.images.tables import root_mean_square

_BETTER = 0.5
"""Share of the rms below which the other model is named"""
_FEWEST = 0.5
"""Smallest reach of the readings in units of the focal length: of a narrow view both models describe the lens"""
_WHOLE = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2")
"""What a pinhole estimates before a fisheye is held against it"""
_LEAST = 0.5
"""Residuals [px] below which no fisheye is sought: corners alone can have them"""
_STEPS = 100
_MOST_STEPS = 400
"""Of a robust start and the adjustment from it"""
_WIDEST = np.cos(np.radians(80))
"""Cosine of the angle off the axis up to which a pinhole is compared with a fisheye"""


def as_fisheye(problem: CameraProblem, settings: CameraSettings) -> CameraProblem:
    """Return the calibration of the same readings with the model fisheye, with starting values of its own."""
    fisheye = replace(_fisheye(settings), image_size=problem.image_size)
    return build(problem.rig, fisheye, replace(problem.sighted, warnings=()))


def _fisheye(settings: CameraSettings) -> CameraSettings:
    """Return a camera with the usual parameters of a fisheye.

    A principal point that the job holds is held here, too: what its freedom explains is no matter of the model.
    """
    usual = CameraSettings(model="fisheye", image_size=settings.image_size, pixel_size=settings.pixel_size)
    held = [name for name in ("cx", "cy") if name not in settings.estimate]
    given: dict[str, Any] = {name: value for name, value in settings.given().items() if name in held}
    return replace(usual, estimate=tuple(name for name in usual.estimate if name not in held), **given)


def other_settings(job: Job[Settings, Files], problem: CameraProblem) -> Iterator[tuple[Mistake, Job[Settings, Files]]]:
    """Yield the model fisheye where a pinhole is calibrated, and a pinhole with all its distortion is no better.

    A lens whose distortion the job does not estimate is no fisheye.
    """
    old = job.settings.camera
    whole = replace(CameraSettings(image_size=problem.image_size), estimate=_WHOLE)
    left = _left(build(problem.rig, whole, replace(problem.sighted, warnings=())))
    if left < _LEAST or not fisheye_instead(problem, old, left):
        return
    new = _fisheye(old)
    write: dict[str, str | list[str]] = {"model": "fisheye", "convention": ""}
    write |= {name: "" for name in old.given() if name not in new.given()}
    if old.estimate != CameraSettings().estimate:
        write["estimate"] = list(new.estimate)
    mistake = Mistake(
        "camera", "the lens is a fisheye", "camera: {model: fisheye}", sort="lens", entries=write, steps=_MOST_STEPS
    )
    yield mistake, replace(job, settings=replace(job.settings, camera=new))


def _left(problem: CameraProblem) -> float:
    """Return the root mean square of the residuals [px] of a calibration."""
    groups = [problem.images, *problem.others]
    solution = adjust(problem.blocks.values(), groups, problem.datum, StoppingRule(limit=_STEPS, covariance=False))
    return root_mean_square(problem.images.residuals({**problem.blocks, **solution.blocks}))


def fisheye_instead(problem: CameraProblem, settings: CameraSettings, rms: float) -> list[str]:
    """Return that the model fisheye fits far better than a forward lens whose residuals have this rms [px]."""
    lens, (u, v) = problem.blocks[camera.LENS].named(), problem.images.observations.readings
    reach = float(np.hypot(u - lens["cx"], v - lens["cy"]).max()) / lens.get("f", lens.get("fx", 1.0))
    if problem.convention != "forward" or reach < _FEWEST:
        return []
    try:
        left = _left(as_fisheye(problem, settings))
    except UndeterminedError:
        return []
    if not left < _BETTER * rms:
        return []
    return [
        f"the lens is a fisheye: that model leaves residuals of {left:.2g} px (rms), this one {rms:.2g} px; "
        "write model: fisheye"
    ]


def other_models(problem: CameraProblem, settings: CameraSettings) -> list[CameraProblem]:
    """Return the calibration of the same readings as a pinhole with distortion, for a fisheye, and the other way round.

    A fisheye that sees beyond 80 degrees off its axis has no other, nor has a backward lens.
    """
    if problem.convention == "forward":
        return [as_fisheye(problem, settings)]
    lens, (u, v) = problem.blocks[camera.LENS].named(), problem.images.observations.readings
    seen = direction(lens, u, v, problem.convention)
    if problem.convention == "backward" or not (seen[2] > _WIDEST).all():
        return []
    usual = CameraSettings(image_size=problem.image_size)
    return [build(problem.rig, usual, replace(problem.sighted, warnings=()))]
