"""calibrate-camera: the model of a camera from a board, from targets placed by a CMM, or from a network."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.adjust.outcome import Outcome
from metrocli.errors import InputError, UndeterminedError
from metrocli.geometry import poses
from metrocli.geometry.rotations import rotation_from_euler, rotation_from_vector
from metrocli.imageset import ImageSet
from metrocli.result import Result
from metrocli.settings import Choice, Either, ImageFiles, Quantity, Section, TableFile, setting
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import TEXT, Column, Columns, Table
from metrocli.targets.pattern import Pattern
from metrocli.tasks.camera_advice import explained, ran_out
from metrocli.tasks.camera_compare import compare_models
from metrocli.tasks.camera_problem import Problem, build
from metrocli.tasks.camera_report import KIND, report
from metrocli.tasks.camera_settings import Camera, CameraSimulation
from metrocli.tasks.image_adjustment import Options, adjust_images, must_converge
from metrocli.tasks.image_settings import eccentricity_setting, image_faults
from metrocli.tasks.image_simulation import Shown, pictures, sightings_table, true_targets
from metrocli.tasks.sightings import OBSERVATIONS, START_NOISE, Needs, sightings
from metrocli.tasks.target_list import TARGETS, Targets, known_targets

SIMULATED = ("observations", "images")
SUMMARY = "camera model from images or observed points"
SCALE_BARS = Columns(
    (Column("from", TEXT), Column("to", TEXT), Column("length", "length"), Column("sigma", "length")),
    ("from", "to"),
    "calibrated distances",
)
_FEWEST = {"board": 4, "cmm": 1, "network": 4}
"""Targets an image needs"""


@dataclass(frozen=True)
class Inputs:
    """Image points and targets, or images and a pattern."""

    observations: Path | None = setting(TableFile(OBSERVATIONS), "image coordinates of targets", default=None)
    targets: Path | None = setting(TableFile(TARGETS), "coordinates of targets", default=None)
    images: tuple[Path, ...] | None = setting(
        ImageFiles(), "images, such as img/*.jpg, instead of observations", default=None
    )
    scale_bars: Path | None = setting(
        TableFile(SCALE_BARS), "calibrated distances between targets (rig network)", default=None
    )


@dataclass(frozen=True)
class Settings:
    """Calibrate a camera: focal length, principal point and distortion, with their covariance."""

    rig: str = setting(
        Choice("board", "cmm", "network"),
        "board: a target board in unknown poses; cmm: targets placed by a CMM; network: unknown points and poses",
    )
    inputs: Inputs = setting(Section(Inputs), "the files of the job")
    noise: float | str = setting(
        Either(Quantity("pixel", positive=True, minimum=1e-9), Choice("estimated")),
        "standard deviation of an image coordinate, or 'estimated'",
    )
    camera: Camera = setting(Section(Camera), "the camera", default=Camera())
    pattern: Pattern | None = setting(Section(Pattern), "what the images show", default=None)
    outliers: str = setting(
        Choice("report", "remove"), "name outliers, or leave them out and list them", default="report"
    )

    eccentricity: str = eccentricity_setting()
    simulation: CameraSimulation | None = setting(
        Section(CameraSimulation), "the truth for `metrocli simulate`", default=None
    )

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield what does not fit together."""
        yield from image_faults(self.inputs.observations, self.inputs.images, self.pattern, self.inputs.targets)
        if self.inputs.observations is not None and self.camera.image_size is None:
            yield (
                "camera",
                "image_size is missing: observations do not say how large the images are; "
                "write e.g. image_size: [2592, 1944]",
            )
        if self.inputs.scale_bars is not None and self.rig != "network":
            yield "inputs.scale_bars", "scale bars belong to rig: network"


def run(
    settings: Settings,
    observations: Table | None = None,
    targets: Table | None = None,
    images: ImageSet | None = None,
    scale_bars: Table | None = None,
) -> Result:
    """Calibrate; raises InputError, UndeterminedError or NotConvergedError."""
    return solved(*prepared(settings, observations, targets, images, scale_bars))


def compare(
    settings: Settings,
    observations: Table | None = None,
    targets: Table | None = None,
    images: ImageSet | None = None,
    scale_bars: Table | None = None,
) -> Table:
    """Return what each lens model of the ladder from pinhole to rational with prism gives, a row for each."""
    _, problem = prepared(settings, observations, targets, images, scale_bars)
    return compare_models(problem)


def prepared(
    settings: Settings,
    observations: Table | None,
    targets: Table | None,
    images: ImageSet | None,
    scale_bars: Table | None,
) -> tuple[Settings, Problem]:
    """Return the adjustment with its starting values, and the settings with the size of the images."""
    if images is not None:
        declared, size = settings.camera.image_size or images.size, images.size
        if tuple(declared) != tuple(size):
            raise InputError(
                f"the images are {size[0]} x {size[1]} px, but camera: image_size says {declared[0]} x {declared[1]} px"
            )
        settings = replace(settings, camera=replace(settings.camera, image_size=size))
    needs = Needs(_FEWEST[settings.rig], float("nan") if settings.rig == "network" else 0.0)
    sighted = sightings(settings, observations, targets, images, needs)
    return settings, build(settings.rig, settings.camera, sighted, scale_bars)


def solved(settings: Settings, problem: Problem) -> Result:
    """Adjust a problem and report it."""
    options = Options(settings.outliers == "remove", settings.noise == "estimated", problem.image_size)
    adjusted = adjust_images(problem.blocks, problem.images, problem.others, problem.datum, options)
    solution = adjusted.solution
    if solution.undetermined or solution.outcome is Outcome.TOO_FEW or ran_out(problem, solution):
        raise UndeterminedError(explained(problem, solution))
    must_converge(solution)
    return report(problem, settings.camera, adjusted)


def simulate(settings: Settings, options: SimulationOptions, targets: Table | None = None, **_: object) -> Simulation:
    """Return the sightings that the camera of `simulation:` gives, with noise, and pictures if they are asked for."""
    truth, size = settings.simulation, settings.camera.image_size
    if truth is None or size is None:
        raise InputError(
            "simulate needs the truth: give `simulation: {lens: {f: 2800 px, ...}}` and camera: image_size"
        )
    rng = np.random.default_rng(options.seed)
    known = true_targets(known_targets(settings.pattern, targets, 0.0), rng)
    views = simulated_views(settings.rig, truth, known, rng)
    lens = {"cx": (size[0] - 1) / 2, "cy": (size[1] - 1) / 2, **truth.lens.given()}
    shown = Shown(lens, size, views.images, views.to_camera, known, settings.camera.convention)
    sigma = settings.noise if isinstance(settings.noise, float) else START_NOISE
    table = sightings_table(shown, sigma, rng, views.only)
    drawn = (
        pictures(shown, settings.pattern, rng, views.only) if options.images and settings.pattern is not None else ()
    )
    true = dict(lens)
    if truth.extrinsics is not None:
        true |= {name: float(getattr(truth.extrinsics, name)) for name in poses.EULER}
    return Simulation({"observations.csv": table}, true, drawn)


@dataclass(frozen=True)
class Views:
    """Images of a simulation: their names, the pose that carries targets into each, and the targets that each shows."""

    images: tuple[str, ...]
    to_camera: Array
    only: Callable[[int], list[int]] | None = None


def simulated_views(rig: str, truth: CameraSimulation, known: Targets, rng: np.random.Generator) -> Views:
    """Return one image for each target with rig cmm, else views from random sides of the targets."""
    if rig == "cmm":
        if truth.extrinsics is None:
            raise InputError("simulation: rig cmm needs extrinsics: where the camera is in the reference frame")
        at = np.array([getattr(truth.extrinsics, name) for name in poses.EULER])
        back = poses.inverse(poses.pose_from_euler(at[:3], at[3:]))
        names = tuple(f"{name}.png" for name in known.names)
        return Views(names, np.broadcast_to(back, (len(names), 6)), lambda image: [image])
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


__all__ = ["KIND", "SIMULATED", "SUMMARY", "Inputs", "Settings", "compare", "run", "simulate"]
