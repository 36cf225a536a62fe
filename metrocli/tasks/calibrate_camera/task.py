"""calibrate-camera: the model of a camera from a board, from targets placed by a CMM, or from a network."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from metrocli.adjust.outcome import Outcome
from metrocli.diagnosis.adjusted_job import Subject
from metrocli.effects.model import extended
from metrocli.effects.wanted import Wanted
from metrocli.errors import InputError, UndeterminedError
from metrocli.geometry import poses
from metrocli.imageset import ImageSet
from metrocli.result import Result
from metrocli.settings import Choice, Either, ImageFiles, Quantity, Section, TableFile, setting
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import TEXT, Column, Columns, Table
from metrocli.targets.pattern import Pattern
from metrocli.tasks.calibrate_camera.advice import explained, ran_out
from metrocli.tasks.calibrate_camera.compare import compare_models
from metrocli.tasks.calibrate_camera.diagnosis import subject
from metrocli.tasks.calibrate_camera.problem import Problem, build
from metrocli.tasks.calibrate_camera.report import KIND, report
from metrocli.tasks.calibrate_camera.simulation import conditions, simulated_views, true_model
from metrocli.tasks.shared.images.adjustment import Adjusted, Options, adjust_images, must_converge
from metrocli.tasks.shared.images.camera_settings import Camera, CameraSimulation
from metrocli.tasks.shared.images.planted_effects import planted, refuse_pictures
from metrocli.tasks.shared.images.rendering import Draw, pictures
from metrocli.tasks.shared.images.settings import eccentricity_setting, image_faults
from metrocli.tasks.shared.images.sightings import OBSERVATIONS, START_NOISE, Needs, sightings
from metrocli.tasks.shared.images.simulation import Shown, sightings_table, sights, true_targets
from metrocli.tasks.shared.images.target_list import TARGETS, known_targets

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
    effects: Sequence[Wanted] = (),
) -> Result:
    """Calibrate; raises InputError, UndeterminedError or NotConvergedError."""
    settings, problem = prepared(settings, observations, targets, images, scale_bars)
    problem = with_effects(problem, effects)
    return report(problem, settings.camera, solved(settings, problem))


def diagnosed(
    settings: Settings,
    observations: Table | None = None,
    targets: Table | None = None,
    images: ImageSet | None = None,
    scale_bars: Table | None = None,
    effects: Sequence[Wanted] = (),
) -> Subject:
    """Return the job as diagnosis sees it, with all its readings; raises as `run` does."""
    settings, problem = prepared(settings, observations, targets, images, scale_bars)
    problem = with_effects(problem, effects)
    return subject(problem, solved(replace(settings, outliers="report"), problem))


def with_effects(problem: Problem, effects: Sequence[Wanted]) -> Problem:
    """Return the calibration with the effects of the job."""
    return problem.with_model(extended(problem.model(), effects)) if effects else problem


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


def solved(settings: Settings, problem: Problem) -> Adjusted:
    """Adjust a problem; raises UndeterminedError or NotConvergedError where it has no good solution."""
    options = Options(settings.outliers == "remove", settings.noise == "estimated", problem.image_size)
    adjusted = adjust_images(problem.blocks, problem.images, problem.others, problem.datum, options)
    solution = adjusted.solution
    if solution.undetermined or solution.outcome is Outcome.TOO_FEW or ran_out(problem, solution):
        raise UndeterminedError(explained(problem, solution))
    must_converge(solution)
    return adjusted


def simulate(
    settings: Settings,
    options: SimulationOptions,
    targets: Table | None = None,
    effects: Sequence[Wanted] = (),
    **_: object,
) -> Simulation:
    """Return the sightings that the camera of `simulation:` gives, with noise and effects; pictures if asked for."""
    truth, size = settings.simulation, settings.camera.image_size
    if truth is None or size is None:
        raise InputError(
            "simulate needs the truth: give `simulation: {lens: {f: 2800 px, ...}}` and camera: image_size"
        )
    rng = np.random.default_rng(options.seed)
    known = true_targets(known_targets(settings.pattern, targets, 0.0), rng)
    views = simulated_views(settings.rig, truth, known, rng)
    lens = {"cx": (size[0] - 1) / 2, "cy": (size[1] - 1) / 2, **truth.lens.given()}
    times = conditions(truth, len(views.images))
    shown = Shown(lens, size, views.images, views.to_camera, known, settings.camera.convention, times)
    sigma = settings.noise if isinstance(settings.noise, float) else START_NOISE
    seen = sights(shown, views.only)
    seen, values = planted(true_model(settings.rig, shown, seen), seen, effects)
    table = sightings_table(shown, seen, sigma, rng)
    drawn: Iterable[tuple[str, Draw]] = ()
    if options.images and settings.pattern is not None:
        refuse_pictures(effects)
        drawn = pictures(shown, settings.pattern, rng, views.only)
    true = dict(lens)
    if truth.extrinsics is not None:
        true |= {name: float(getattr(truth.extrinsics, name)) for name in poses.EULER}
    return Simulation({"observations.csv": table}, true | values, drawn)


__all__ = ["KIND", "SIMULATED", "SUMMARY", "Inputs", "Settings", "compare", "run", "simulate"]
