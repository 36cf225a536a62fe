"""Other lens models for the same readings: a fisheye that is given as a pinhole is named."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from metrocli.adjust.adjustment import Control, adjust
from metrocli.diagnosis.corrections import Mistake
from metrocli.errors import UndeterminedError
from metrocli.instruments import camera
from metrocli.instruments.lenses.lens import direction
from metrocli.tasks.calibrate_camera.build import build
from metrocli.tasks.calibrate_camera.problem import Problem
from metrocli.tasks.calibrate_camera.settings import Camera, Files, Settings
from metrocli.tasks.job import Job
from metrocli.tasks.shared.images.settings import SPLINE
from metrocli.tasks.shared.images.tables import root_mean_square

_BETTER = 0.5
"""Share of the rms below which the other model is named"""
_FEWEST = 0.5
"""Smallest reach of the readings in units of the focal length: of a narrow view both models describe the lens"""
_STEPS = 100
_MOST_STEPS = 400
"""Of a robust start and the adjustment from it"""
_WIDEST = np.cos(np.radians(80))
"""Cosine of the angle off the axis up to which a pinhole is compared with a fisheye"""


def as_fisheye(problem: Problem, settings: Camera) -> Problem:
    """Return the calibration of the same readings with the model fisheye, with starting values of its own."""
    fisheye = replace(_fisheye(settings), image_size=problem.image_size)
    return build(problem.rig, fisheye, replace(problem.sighted, warnings=()))


def _fisheye(settings: Camera) -> Camera:
    """Return a camera with the usual parameters of a fisheye.

    A principal point that the job holds is held here, too: what its freedom explains is no matter of the model.
    """
    usual = Camera(model="fisheye", image_size=settings.image_size, pixel_size=settings.pixel_size)
    held = [name for name in ("cx", "cy") if name not in settings.estimate]
    given: dict[str, Any] = {name: value for name, value in settings.given().items() if name in held}
    return replace(usual, estimate=tuple(name for name in usual.estimate if name not in held), **given)


def other_settings(job: Job[Settings, Files], fits: bool) -> Iterator[tuple[Mistake, Job[Settings, Files]]]:
    """Yield the model fisheye where a job calibrates a pinhole; nothing if a declared noise fits."""
    old, known = job.settings.camera, fits and isinstance(job.settings.noise, float)
    if known or job.settings.cameras is not None or old.convention != "forward" or old.model == SPLINE:
        return
    new = _fisheye(old)
    write: dict[str, str | list[str]] = {"model": "fisheye", "convention": ""}
    write |= {name: "" for name in old.given() if name not in new.given()}
    if old.estimate != Camera().estimate:
        write["estimate"] = list(new.estimate)
    mistake = Mistake(
        "camera", "the lens is a fisheye", "camera: {model: fisheye}", sort="lens", entries=write, steps=_MOST_STEPS
    )
    yield mistake, replace(job, settings=replace(job.settings, camera=new))


def fisheye_instead(problem: Problem, settings: Camera, rms: float) -> list[str]:
    """Return that the model fisheye fits far better than a forward lens whose residuals have this rms [px]."""
    lens, (u, v) = problem.blocks[camera.LENS].named(), problem.images.observations.readings
    reach = float(np.hypot(u - lens["cx"], v - lens["cy"]).max()) / lens.get("f", lens.get("fx", 1.0))
    if problem.convention != "forward" or reach < _FEWEST:
        return []
    try:
        other = as_fisheye(problem, settings)
    except UndeterminedError:
        return []
    groups = [other.images, *other.others]
    found = adjust(other.blocks.values(), groups, other.datum, Control(limit=_STEPS, covariance=False))
    left = root_mean_square(other.images.residuals({**other.blocks, **found.blocks}))
    if not left < _BETTER * rms:
        return []
    return [
        f"the lens is a fisheye: that model leaves residuals of {left:.2g} px (rms), this one {rms:.2g} px; "
        "write camera: {model: fisheye}"
    ]


def other_models(problem: Problem, settings: Camera) -> list[Problem]:
    """Return the calibration of the same readings as a pinhole with distortion, for a fisheye, and the other way round.

    A fisheye that sees beyond 80 degrees off its axis has no other, nor has a backward lens.
    """
    if problem.convention == "forward":
        return [as_fisheye(problem, settings)]
    lens, (u, v) = problem.blocks[camera.LENS].named(), problem.images.observations.readings
    seen = direction(lens, u, v, problem.convention)
    if problem.convention == "backward" or not (seen[2] > _WIDEST).all():
        return []
    usual = Camera(image_size=problem.image_size)
    return [build(problem.rig, usual, replace(problem.sighted, warnings=()))]
