"""A simulated calibration of a camera, or of several that are fixed to each other, and the truth behind it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.effects.model import Model, Place
from metrocli.errors import InputError, UsageError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.geometry.rotations import rotation_from_euler, rotation_from_vector
from metrocli.instruments import camera
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import Table
from metrocli.tasks.calibrate_camera.multi_camera.truth import CameraSimulation
from metrocli.tasks.calibrate_camera.readings import ends_of
from metrocli.tasks.calibrate_camera.settings import CameraSettings, Files, OneOfSeveral, Settings
from metrocli.tasks.job import Job
from metrocli.tasks.shared.images.adjustment import IMAGES
from metrocli.tasks.shared.images.settings import Extrinsics, LensValues
from metrocli.tasks.shared.images.simulation import (
    ExactImagePoints,
    SimulatedCamera,
    image_group,
    pictures,
    planted,
    sightings_table,
    sights,
    true_targets,
)
from metrocli.tasks.shared.images.target_list import TargetCoordinates, known_targets
from metrocli.tasks.shared.lists import listed_places

_FIRST_TEMPERATURE = 20.0
"""At the first image [degC] (ISO 1)"""
_UNKNOWN = 100.0
"""Standard deviation of a place that is listed as unknown [mm]: calibrated lengths between such places decide"""
_ITERATIONS = 50
_ROUGH = 0.2
"""Error of a listed distance relative to its calibrated length, beyond which one of the two is a mistake"""
_SETTLED = 1e-9
"""Move of a place [mm] at which the iteration ends"""


def simulate(job: Job[Settings, Files], options: SimulationOptions) -> Simulation:
    """Return the image points that the cameras of `simulation:` would measure, with noise and effects.

    Pictures are added if the options ask for them. Raises InputError if the truth or a size of images is missing, or if
    a camera sees no target, and UsageError for effects on several cameras.
    """
    settings, truth = job.settings, job.settings.simulation
    cameras: Mapping[str, CameraSettings] = {"": settings.camera} if settings.cameras is None else settings.cameras
    if truth is None or any(given.image_size is None for given in cameras.values()) or not _lenses(settings, truth):
        of_one = "`simulation: {lens: {f: 2800 px, ...}}` and camera: image_size"
        of_each = "`simulation: {cameras: {NAME: {lens: {f: 2800 px, ...}}, ...}}` and the image_size of each camera"
        raise InputError(f"simulate needs the truth: give {of_one if settings.cameras is None else of_each}")
    if settings.cameras is not None and job.effects:
        raise UsageError("effects are planted in the images of a single camera: leave them out, or write `camera:`")
    rng = np.random.default_rng(options.seed)
    known = simulated_targets(settings, job.files, rng)
    views = simulated_views(settings.rig, truth, known, rng)
    times, shown = conditions(truth, len(views.images)), list[SimulatedCamera]()
    for name, lens in _lenses(settings, truth).items():
        given, images, to_camera = cameras[name], views.images, views.to_camera
        width, height = given.image_size or (0, 0)
        if isinstance(given, OneOfSeveral):
            images = tuple(given.images.replace("*", image.removesuffix(".png")) for image in images)
            to_camera = poses.compose(_into(truth, name, len(images)), to_camera)
        values = {"cx": (width - 1) / 2, "cy": (height - 1) / 2, **lens.given()}
        shown.append(SimulatedCamera(values, (width, height), images, to_camera, known, given.convention, times, name))
    seen, of_effects = sights(shown, views.only), dict[str, float]()
    if settings.cameras is None:
        seen, of_effects = planted(true_model(settings.rig, shown[0], seen), seen, job.effects)
    files = {"observations.csv": sightings_table(shown, seen, settings.noise, rng)}
    if settings.rig == "network":
        files["true_points.csv"] = listed_places("point", known.names, known.points)
    elif job.files.targets is None:
        files["targets.csv"] = listed_places("target", known.names, known.points)
    drawn = pictures(shown, settings.pattern if options.images else None, rng, views.only, job.effects)
    return Simulation(files, _true_values(shown, truth) | of_effects, drawn)


def _lenses(settings: Settings, truth: CameraSimulation) -> Mapping[str, LensValues]:
    """Return the true lens of each camera by its name, that of a single one without a name; none if it is missing."""
    if settings.cameras is not None:
        return {name: camera.lens for name, camera in (truth.cameras or {}).items()}
    return {} if truth.lens is None else {"": truth.lens}


def _into(truth: CameraSimulation, name: str, count: int) -> Array:
    """Return the pose that takes points of the first camera's frame into a camera's, at each exposure (count, 6)."""
    at = (truth.cameras or {})[name].extrinsics
    return np.zeros((count, 6)) if at is None else np.broadcast_to(_into_camera(at), (count, 6))


def _into_camera(at: Extrinsics) -> Array:
    """Return the pose that takes points of the reference frame into the frame of a camera, (6,)."""
    values = np.array([getattr(at, name) for name in poses.EULER])
    return poses.inverse(poses.pose_from_euler(values[:3], values[3:]))


def _true_values(shown: Sequence[SimulatedCamera], truth: CameraSimulation) -> dict[str, float]:
    """Return lens and pose of each camera by the names of the estimates; the pose of the first is that of the rig."""
    lenses = [(f"{camera.name}." if camera.name else "", camera.lens) for camera in shown]
    values = {prefix + key: value for prefix, lens in lenses for key, value in lens.items()}
    places = [camera.extrinsics for camera in (truth.cameras or {}).values()]
    for (prefix, _), at in zip(lenses, [truth.extrinsics, *places[1:]], strict=True):
        values |= {prefix + key: float(getattr(at, key)) for key in poses.EULER if at is not None}
    return values


def conditions(truth: CameraSimulation, images: int) -> dict[str, Array]:
    """Return time [s] and temperature [degC] of each image, as far as the simulation sets them."""
    turn = np.arange(images, dtype=float)
    covariates = {} if truth.interval is None else {"t": turn * truth.interval}
    if truth.warming:
        covariates["temp"] = _FIRST_TEMPERATURE + truth.warming * turn / max(images - 1, 1)
    return covariates


def simulated_targets(settings: Settings, files: Files, rng: np.random.Generator) -> TargetCoordinates:
    """Return the true targets of a job; raises InputError as `with_lengths`."""
    unknown = np.nan if settings.rig == "network" else 0.0
    places = true_targets(known_targets(settings.pattern, files.targets, unknown), rng)
    return with_lengths(places, (("scale bar", files.scale_bars), ("test length", files.test_lengths)), rng)


def with_lengths(
    places: TargetCoordinates, lengths: Sequence[tuple[str, Table | None]], rng: np.random.Generator
) -> TargetCoordinates:
    """Return true targets between which calibrated lengths are right, but for their errors of calibration.

    Places x0 with standard deviations S move to the least `|(x - x0) / S|^2 + |(L - l(x)) / s|^2`. L are the lengths,
    drawn about the calibrated ones. So places in a rough list give way, and those that are known exactly stay.
    `lengths` are pairs of what a length is, in words, and its table. Raises InputError for ends that are not targets,
    for lengths that are far from what the list has, and where no places settle.
    """
    tables = [(table, ends_of(table, places.names, None, what)) for what, table in lengths if table is not None]
    if not tables:
        return places
    _must_be_near(tables, places)
    ends = np.concatenate([pair for _, pair in tables], axis=1)
    sigma = np.concatenate([table.numbers("sigma") for table, _ in tables])
    drawn = np.concatenate([table.numbers("length") for table, _ in tables]) + rng.normal(0.0, 1.0, len(sigma)) * sigma
    used, number = np.unique(ends, return_inverse=True)
    number_of_end, other = number.reshape(ends.shape)
    begun = places.points[used]
    variance = np.where(np.isnan(places.sigma[used]), _UNKNOWN, places.sigma[used]).ravel() ** 2
    moved, rows = np.zeros_like(begun), np.arange(len(drawn))
    for _ in range(_ITERATIONS):
        away = (begun + moved)[other] - (begun + moved)[number_of_end]
        now = np.maximum(np.linalg.norm(away, axis=1), 1e-300)
        slopes = np.zeros((len(drawn), *begun.shape))
        slopes[rows, other] = away / now[:, None]
        slopes[rows, number_of_end] = -slopes[rows, other]
        slope = slopes.reshape(len(drawn), -1)
        weight = np.linalg.pinv((slope * variance) @ slope.T + np.diag(sigma**2), rcond=1e-14, hermitian=True)
        before, moved = moved, (variance * (slope.T @ (weight @ (drawn - now + slope @ moved.ravel())))).reshape(-1, 3)
        if np.abs(moved - before).max() < _SETTLED:
            break
    else:
        raise InputError(
            f"no places of the targets give the calibrated lengths: after {_ITERATIONS} steps they still move by "
            f"{np.abs(moved - before).max():.1e} mm\ncompare the lengths with the list of targets"
        )
    points = places.points.copy()
    points[used] += moved
    return replace(places, points=points)


def _must_be_near(tables: Sequence[tuple[Table, Index]], places: TargetCoordinates) -> None:
    """Raise InputError that names every length which differs from its distance in the list by far."""
    faults = []
    for table, (first, other) in tables:
        listed = np.linalg.norm(places.points[other] - places.points[first], axis=1)
        known = table.numbers("length")
        faults += table.faults_at(
            np.flatnonzero(np.abs(listed - known) > _ROUGH * known),
            lambda row, listed=listed, known=known: (  # type: ignore[misc]
                f"the calibrated length is {known[row]:g} mm, the list of targets has {listed[row]:g} mm"
            ),
            lambda row: "correct the one that is wrong: `simulate` starts from both",
        )
    if faults:
        raise InputError(faults)


@dataclass(frozen=True)
class Views:
    """The images of a simulation."""

    images: tuple[str, ...]
    to_camera: Array
    """Pose that takes targets into the camera's frame, for each image (images, 6)"""
    only: Callable[[int], list[int]] | None = None
    """Returns the targets that an image shows; None: all"""


def simulated_views(rig: str, truth: CameraSimulation, known: TargetCoordinates, rng: np.random.Generator) -> Views:
    """Return one image of each target with rig cmm, else views of all targets from random directions.

    Raises InputError if rig cmm has no extrinsics.
    """
    if rig == "cmm":
        if truth.extrinsics is None:
            raise InputError("simulation: rig cmm needs extrinsics: where the camera is in the reference frame")
        names = tuple(f"{name}.png" for name in known.names)
        return Views(names, np.broadcast_to(_into_camera(truth.extrinsics), (len(names), 6)), lambda image: [image])
    n = truth.images
    axis, tilt, roll = (
        rng.uniform(0, 2 * np.pi, n),
        truth.tilt * np.sqrt(rng.uniform(0, 1, n)),
        rng.uniform(-np.pi, np.pi, n),
    )
    vector = np.column_stack([np.cos(axis) * tilt, np.sin(axis) * tilt, np.zeros(n)])
    rotation = rotation_from_euler(np.zeros(n), np.zeros(n), roll) @ rotation_from_vector(vector)
    extent = float(np.ptp(known.points, axis=0).max())
    aim = np.column_stack([rng.uniform(-0.1, 0.1, (n, 2)) * extent, truth.distance * rng.uniform(0.85, 1.2, n)])
    centre = known.points.mean(axis=0)
    return Views(tuple(f"view{i + 1:02d}.png" for i in range(n)), poses.pose(rotation, aim - rotation @ centre))


def true_model(rig: str, shown: SimulatedCamera, seen: ExactImagePoints) -> Model:
    """Return the model of the calibration at the truth, with the exact image points as readings.

    The caller adds the simulated effects to it (`planted`).
    """
    views = shown.to_camera if rig == "board" else poses.inverse(shown.to_camera)
    name, images = camera.view_name(rig), shown.images
    if rig == "cmm":
        views, images = views[:1], ("",)
    blocks = {
        camera.LENS: camera.lens_block(shown.lens, (), shown.image_size),
        name: camera.view_block(views, images, 1.0, name),
        camera.TARGET: camera.target_block(shown.targets.points, shown.targets.names, False, 1.0),
    }
    group = image_group([shown], seen, camera.chain(rig, shown.convention))
    places = {"image": Place(shown.images, "view"), "target": Place(shown.targets.names, camera.TARGET)}
    nominal = {camera.TARGET: shown.targets.points}
    return Model(blocks, (group,), None, (IMAGES,), places, nominal=nominal)
