"""A simulated measurement of several cameras that are fixed to each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import InputError, UsageError
from metrocli.geometry import poses
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.tasks.calibrate_camera.multi_camera.truth import CameraSimulation, TrueCamera
from metrocli.tasks.calibrate_camera.settings import Files, OneOfSeveral, Settings
from metrocli.tasks.calibrate_camera.simulation import conditions, simulated_targets, simulated_views
from metrocli.tasks.job import Job
from metrocli.tasks.shared.images.simulation import SimulatedCamera, pictures, sightings_table, sights
from metrocli.tasks.shared.lists import listed_places


def simulate(job: Job[Settings, Files], cameras: Mapping[str, OneOfSeveral], options: SimulationOptions) -> Simulation:
    """Return the image points that all cameras of `simulation:` would measure, with noise.

    Raises InputError if the truth or a size of images is missing, or if a camera sees no target, and UsageError for
    effects.
    """
    settings, truth = job.settings, job.settings.simulation
    if truth is None or truth.cameras is None or any(given.image_size is None for given in cameras.values()):
        raise InputError(
            "simulate needs the truth: give `simulation: {cameras: {NAME: {lens: {f: 2800 px, ...}}, ...}}` and the "
            "image_size of each camera"
        )
    if job.effects:
        raise UsageError("effects are planted in the images of a single camera: leave them out, or write `camera:`")
    rng = np.random.default_rng(options.seed)
    known = simulated_targets(settings, job.files, rng)
    views = simulated_views(settings.rig, truth, known, rng)
    times = conditions(truth, len(views.images))
    shown = [
        SimulatedCamera(
            _true_lens(given, truth.cameras[name]),
            given.image_size or (0, 0),
            tuple(given.images.replace("*", image.removesuffix(".png")) for image in views.images),
            poses.compose(_into(truth.cameras[name], len(views.images)), views.to_camera),
            known,
            given.convention,
            times,
            name,
        )
        for name, given in cameras.items()
    ]
    files = {"observations.csv": sightings_table(shown, sights(shown, views.only), settings.noise, rng)}
    if settings.rig == "network":
        files["true_points.csv"] = listed_places("point", known.names, known.points)
    elif job.files.targets is None:
        files["targets.csv"] = listed_places("target", known.names, known.points)
    drawn = pictures(shown, settings.pattern if options.images else None, rng, views.only)
    return Simulation(files, _true_values(shown, truth), drawn)


def _true_lens(given: OneOfSeveral, truth: TrueCamera) -> dict[str, float]:
    width, height = given.image_size or (0, 0)
    return {"cx": (width - 1) / 2, "cy": (height - 1) / 2, **truth.lens.given()}


def _into(truth: TrueCamera, count: int) -> Array:
    """Return the pose that takes points of the first camera's frame into a camera's, at each exposure (count, 6)."""
    at = truth.extrinsics
    if at is None:
        return np.zeros((count, 6))
    held = poses.pose_from_euler(np.array([at.x, at.y, at.z]), np.array([at.alpha, at.beta, at.gamma]))
    return np.broadcast_to(poses.inverse(held), (count, 6))


def _true_values(shown: Sequence[SimulatedCamera], truth: CameraSimulation) -> dict[str, float]:
    """Return lens and pose of each camera by the names of the estimates; the pose of the first is that of the rig."""
    values = {f"{camera.name}.{key}": value for camera in shown for key, value in camera.lens.items()}
    places = [camera.extrinsics for camera in (truth.cameras or {}).values()]
    for camera, at in zip(shown, [truth.extrinsics, *places[1:]], strict=True):
        values |= {f"{camera.name}.{key}": getattr(at, key) for key in poses.EULER if at is not None}
    return values
