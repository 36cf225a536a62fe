"""A simulated measurement of several cameras that are fixed to each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import InputError, UsageError
from metrocli.geometry import poses
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import Table
from metrocli.tasks.calibrate_camera.settings import Files, OneOfSeveral, Settings, TrueCamera
from metrocli.tasks.calibrate_camera.simulation import Views, conditions, simulated_targets, simulated_views
from metrocli.tasks.job import Job
from metrocli.tasks.shared.images.settings import Extrinsics
from metrocli.tasks.shared.images.sightings import START_NOISE
from metrocli.tasks.shared.images.simulation import Shown, Sights, pictures, sightings_table, sights
from metrocli.tasks.shared.images.target_list import Targets
from metrocli.tasks.shared.lists import listed_places


def simulate(job: Job[Settings, Files], cameras: Mapping[str, OneOfSeveral], options: SimulationOptions) -> Simulation:
    """Return the image points that all cameras of `simulation:` would measure, with noise.

    Raises InputError if the truth or a size of images is missing, or if a camera sees no target, and UsageError for
    effects.
    """
    settings, truth = job.settings, job.settings.simulation
    if truth is None or truth.cameras is None or any(one.image_size is None for one in cameras.values()):
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
    each = {name: _shown(one, truth.cameras[name], views, known, times) for name, one in cameras.items()}
    sigma = settings.noise if isinstance(settings.noise, float) else START_NOISE
    tables = [sightings_table(one, _sights(name, one, views), sigma, rng) for name, one in each.items()]
    drawn = (
        ()
        if not options.images or settings.pattern is None
        else chain.from_iterable([pictures(one, settings.pattern, rng, views.only) for one in each.values()])
    )
    files = {"observations.csv": _below_one_another(tables)}
    if job.files.targets is None:
        files["targets.csv"] = listed_places("target", known.names, known.points)
    true = {f"{name}.{key}": value for name, one in each.items() for key, value in one.lens.items()}
    placed = {name: one.extrinsics for name, one in truth.cameras.items()}
    placed[next(iter(placed))] = truth.extrinsics
    true |= {f"{name}.{key}": getattr(at, key) for name, at in placed.items() if at is not None for key in poses.EULER}
    return Simulation(files, true, drawn)


def _shown(one: OneOfSeveral, truth: TrueCamera, views: Views, known: Targets, times: Mapping[str, Array]) -> Shown:
    """Return a camera at all exposures; the part of the name of an image for which * stands is that of the exposure."""
    size = one.image_size or (0, 0)
    lens = {"cx": (size[0] - 1) / 2, "cy": (size[1] - 1) / 2, **truth.lens.given()}
    names = tuple(one.images.replace("*", name.removesuffix(".png")) for name in views.images)
    held = np.broadcast_to(poses.inverse(_pose(truth.extrinsics)), views.to_camera.shape)
    return Shown(lens, size, names, poses.compose(held, views.to_camera), known, one.convention, times)


def _pose(at: Extrinsics | None) -> Array:
    """Return the pose of a camera in the frame of the first, (6,)."""
    if at is None:
        return np.zeros(6)
    return poses.pose_from_euler(np.array([at.x, at.y, at.z]), np.array([at.alpha, at.beta, at.gamma]))


def _sights(name: str, shown: Shown, views: Views) -> Sights:
    try:
        return sights(shown, views.only)
    except InputError as error:
        raise InputError(f"camera {name}: {error.faults[0].message}") from error


def _below_one_another(tables: Sequence[Table]) -> Table:
    columns = {name: np.concatenate([one.columns[name] for one in tables]) for name in tables[0].columns}
    return Table(columns, tables[0].units)
