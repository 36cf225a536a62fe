"""Other lens models for the same readings: a fisheye that is given as a pinhole is named."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.arrays import Array
from metrocli.diagnosis.corrections import Mistake
from metrocli.errors import UndeterminedError
from metrocli.instruments import camera
from metrocli.instruments.lenses.lens import direction
from metrocli.tasks.calibrate_camera.build import build
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.settings import CameraSettings, Files, Settings
from metrocli.tasks.job import Job
from metrocli.tasks.shared.images.settings import MODELS
from metrocli.tasks.shared.images.tables import root_mean_square, scatter
from metrocli.words import in_a_row

_BETTER = 0.5
"""Share of the rms below which the other model is named"""
_FEWEST = 0.5
"""Smallest radius of the readings in focal lengths: within a narrow view both models describe the lens"""
_WHOLE = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2")
"""What a pinhole estimates before a fisheye is compared with it"""
_FITS = 1.1
"""Residuals of a fisheye fit up to so many times the declared noise; up to so many times them a pinhole is as good"""
_STEPS = 100
_MOST_STEPS = 400
"""Of a robust start and the adjustment from it"""
_WIDEST = np.cos(np.radians(80))
"""Cosine of the angle off the axis up to which a pinhole is compared with a fisheye"""
C = TypeVar("C", bound=CameraSettings)


def as_fisheye(problem: CameraProblem, settings: CameraSettings) -> CameraProblem:
    """Return the calibration of the same readings with the model fisheye, with starting values of its own."""
    fisheye = replace(_fisheye(settings), image_size=problem.image_size)
    return build(problem.rig, fisheye, replace(problem.sighted, warnings=()))


def _fisheye(settings: C) -> C:
    """Return a camera with the usual parameters of a fisheye.

    A principal point that the job holds is held here, too: what its freedom explains is no matter of the model.
    """
    held = [name for name in ("cx", "cy") if name not in settings.estimate]
    usual = [name for name in CameraSettings(model="fisheye").estimate if name not in held]
    new: dict[str, Any] = {name: None for name in settings.given() if name not in held}
    new |= {"model": "fisheye", "convention": None, "base": "opencv", "estimate": tuple(usual)}
    return replace(settings, **new)


def other_settings(job: Job[Settings, Files], problem: CameraProblem) -> Iterator[tuple[Mistake, Job[Settings, Files]]]:
    """Yield the model fisheye where a pinhole is calibrated, and a pinhole with all its distortion is no better.

    A lens whose distortion the job does not estimate is not a fisheye.
    """
    old = job.settings.camera
    if _is_fisheye(problem, old, job.settings.noise):
        new = _fisheye(old)
        yield (
            _mistake("camera", "the lens is a fisheye", "camera: {model: fisheye}", _entries("camera", old, new)),
            replace(job, settings=replace(job.settings, camera=new)),
        )


def other_settings_of_several(
    job: Job[Settings, Files], problems: Mapping[str, CameraProblem]
) -> Iterator[tuple[Mistake, Job[Settings, Files]]]:
    """Yield the model fisheye for the cameras whose readings alone show one, each as `other_settings`."""
    old = job.settings.cameras or {}
    new = {
        name: _fisheye(old[name])
        for name, problem in problems.items()
        if _is_fisheye(problem, old[name], job.settings.noise)
    }
    if new:
        words = f"the lens of {in_a_row(list(new))} is a fisheye"
        each = (_entries(f"cameras.{name}", old[name], entry) for name, entry in new.items())
        entries = {key: text for own in each for key, text in own.items()}
        write = f"model: fisheye in cameras: {in_a_row(list(new))}"
        changed = replace(job.settings, cameras={**old, **new})
        yield _mistake("cameras", words, write, entries), replace(job, settings=changed)


def _mistake(section: str, words: str, write: str, entries: Mapping[str, str | list[str]]) -> Mistake:
    return Mistake(section, words, write, sort="lens", entries=entries, steps=_MOST_STEPS)


def _entries(section: str, old: CameraSettings, new: CameraSettings) -> dict[str, str | list[str]]:
    """Return what a job writes for the new settings of a camera; an empty text for what it leaves out."""
    write: dict[str, str | list[str]] = {"model": "fisheye", "convention": ""}
    write |= {name: "" for name in old.given() if name not in new.given()}
    if old.estimate != CameraSettings().estimate:
        write["estimate"] = list(new.estimate)
    return {f"{section}.{key}": text for key, text in write.items()}


def _is_fisheye(problem: CameraProblem, settings: CameraSettings, noise: float | str) -> bool:
    """Return whether a fisheye fits where a pinhole with all its distortion does not.

    Both are known from the size of the residuals beside the noise: as declared, else the scatter of neighbouring
    points. A fisheye that is far better is one as well, whatever the noise.
    """
    if not _may_be_fisheye(problem):
        return False
    left = _left_by_pinhole(problem)
    try:
        other = as_fisheye(problem, settings)
    except UndeterminedError:
        return False
    residuals, observations = _left(other), other.images.observations
    if isinstance(noise, str):
        image = observations.index.get(camera.VIEW, np.zeros(observations.count, dtype=np.intp))
        known = scatter(residuals, observations.readings, image, problem.image_size)
    else:
        known = np.sqrt(2) * noise
    best = root_mean_square(residuals)
    # a limit in pixels on what a pinhole leaves named one of eleven fisheyes: the noise decides (docs/decisions/260)
    return bool(best <= min(_FITS * known, left / _FITS) or (isinstance(noise, str) and best < _BETTER * left))


def _may_be_fisheye(problem: CameraProblem) -> bool:
    """Return whether a pinhole is calibrated, and the readings reach so far from the axis that a fisheye differs."""
    lens, (u, v) = problem.blocks[camera.LENS].named(), problem.images.observations.readings
    reach = float(np.hypot(u - lens["cx"], v - lens["cy"]).max()) / lens.get("f", lens.get("fx", 1.0))
    return problem.convention == "forward" and reach >= _FEWEST


def _left(problem: CameraProblem) -> Array:
    """Return the residuals (2, n) [px] of a calibration."""
    groups = [problem.images, *problem.others]
    solution = adjust(problem.blocks.values(), groups, problem.datum, StoppingRule(limit=_STEPS, covariance=False))
    return problem.images.residuals({**problem.blocks, **solution.blocks})


def _left_by_pinhole(problem: CameraProblem) -> float:
    """Return the rms [px] that a pinhole with all its distortion leaves of the same readings."""
    whole = replace(CameraSettings(image_size=problem.image_size), estimate=_WHOLE)
    return root_mean_square(_left(build(problem.rig, whole, replace(problem.sighted, warnings=()))))


def fisheye_instead(problem: CameraProblem, settings: CameraSettings, rms: float) -> list[str]:
    """Return that the model fisheye fits far better than a forward lens whose residuals have this rms [px].

    A lens whose distortion the job does not estimate is not a fisheye.
    """
    if not _may_be_fisheye(problem):
        return []
    try:
        left = root_mean_square(_left(as_fisheye(problem, settings)))
    except UndeterminedError:
        return []
    if not (left < _BETTER * rms and left * _FITS <= _left_by_pinhole(problem)):
        return []
    return [
        f"the lens is a fisheye: that model leaves residuals of {left:.2g} px (rms), this one {rms:.2g} px; "
        "write model: fisheye"
    ]


def other_models(problem: CameraProblem, settings: CameraSettings) -> list[CameraProblem]:
    """Return the calibration of the same readings with the other models: fisheye, pinhole and backward correction.

    A fisheye that sees beyond 80 degrees off its axis has no other.
    """
    if problem.convention == "fisheye":
        lens, (u, v) = problem.blocks[camera.LENS].named(), problem.images.observations.readings
        if not (direction(lens, u, v, problem.convention)[2] > _WIDEST).all():
            return []
    others = [_usual(problem, model) for model in ("opencv", "backward") if MODELS[model] != problem.convention]
    return others if problem.convention == "fisheye" else [*others, as_fisheye(problem, settings)]


def _usual(problem: CameraProblem, model: str) -> CameraProblem:
    """Return the calibration of the same readings with the usual parameters of a model."""
    usual = CameraSettings(image_size=problem.image_size, model=model)
    return build(problem.rig, usual, replace(problem.sighted, warnings=()))
