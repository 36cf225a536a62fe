"""align-part: where a part stands in the machine, seen by a camera in the spindle whose clamping angle is found too."""

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
from metrocli.geometry.poses import EULER, pose_from_euler
from metrocli.imageset import ImageSet
from metrocli.instruments.spindle_camera import part_in_camera
from metrocli.result import Result
from metrocli.settings import Choice, Either, FileOf, ImageFiles, ListOf, Quantity, Section, TableFile, setting
from metrocli.simulation import Simulation, SimulationOptions
from metrocli.table import TEXT, Column, Columns, Table
from metrocli.targets.pattern import Pattern
from metrocli.tasks.align_part.camera import camera_of
from metrocli.tasks.align_part.diagnosis import subject
from metrocli.tasks.align_part.problem import Problem, build, spindle_poses
from metrocli.tasks.align_part.report import KIND, explained, predicted, report
from metrocli.tasks.align_part.simulation import Truth, true_model
from metrocli.tasks.shared.images.adjustment import Adjusted, Options, adjust_images, must_converge
from metrocli.tasks.shared.images.camera_settings import CameraFile, Extrinsics
from metrocli.tasks.shared.images.planted_effects import planted, refuse_pictures
from metrocli.tasks.shared.images.rendering import Draw, pictures
from metrocli.tasks.shared.images.settings import eccentricity_setting, image_faults
from metrocli.tasks.shared.images.sightings import OBSERVATIONS, START_NOISE, Needs, sightings
from metrocli.tasks.shared.images.simulation import Shown, sightings_table, sights, true_targets
from metrocli.tasks.shared.images.target_list import TARGETS, known_targets

SIMULATED = ("observations", "images")
SUMMARY = "part location and orientation in the machine (6D/7D)"
POSES = Columns(
    (
        Column("image", TEXT),
        Column("x", "length"),
        Column("y", "length"),
        Column("z", "length"),
        *(Column(name, "angle", required=False) for name in ("a", "b", "c")),
        Column("t", "time", required=False),
        Column("temp", "temperature", required=False),
    ),
    ("image",),
    "commanded poses of the spindle",
)


@dataclass(frozen=True)
class Inputs:
    """The camera, the spindle's poses, and what was seen."""

    camera: Path = setting(
        FileOf(("calibrate-camera",), CameraFile),
        "result of calibrate-camera (rig cmm), or a camera written by hand (.yaml)",
    )
    poses: Path = setting(TableFile(POSES), "commanded pose of the spindle for each image")
    targets: Path = setting(TableFile(TARGETS), "coordinates of targets in the part")
    observations: Path | None = setting(TableFile(OBSERVATIONS), "image coordinates of targets", default=None)
    images: tuple[Path, ...] | None = setting(
        ImageFiles(), "images, such as img/*.png, instead of observations", default=None
    )


@dataclass(frozen=True, kw_only=True)
class AlignSimulation:
    """The truth that `metrocli simulate` starts from."""

    part: Extrinsics = setting(Section(Extrinsics), "the part in the machine")
    clamping_angle: float = setting(
        Either(Quantity("angle"), Quantity("slope")), "true clamping angle gamma_s", default=0.0
    )


@dataclass(frozen=True)
class Settings:
    """Locate a part in the machine from images of a camera in the spindle (6D), with its clamping angle (7D)."""

    inputs: Inputs = setting(Section(Inputs), "the files of the job")
    noise: float | str = setting(
        Either(Quantity("pixel", positive=True, minimum=1e-9), Choice("estimated")),
        "standard deviation of an image coordinate, or 'estimated'",
    )
    estimate: tuple[str, ...] = setting(
        ListOf(Choice("part-pose", "clamping-angle"), distinct=True),
        "unknowns: the 6D or the 7D job",
        default=("part-pose", "clamping-angle"),
    )
    pattern: Pattern | None = setting(Section(Pattern), "what the images show", default=None)
    outliers: str = setting(
        Choice("report", "remove"), "name outliers, or leave them out and list them", default="report"
    )
    eccentricity: str = eccentricity_setting()
    simulation: AlignSimulation | None = setting(
        Section(AlignSimulation), "the truth for `metrocli simulate`", default=None
    )

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield what does not fit together."""
        yield from image_faults(self.inputs.observations, self.inputs.images, self.pattern, self.inputs.targets)
        if "part-pose" not in self.estimate:
            yield "estimate", "part-pose is missing: write [part-pose] for 6D or [part-pose, clamping-angle] for 7D"


def run(
    settings: Settings,
    camera: Result | CameraFile,
    poses: Table,
    targets: Table,
    observations: Table | None = None,
    images: ImageSet | None = None,
    effects: Sequence[Wanted] = (),
) -> Result:
    """Locate the part; raises InputError, UndeterminedError or NotConvergedError."""
    problem = prepared(settings, camera, poses, Seen(targets, observations, images), effects)
    prediction = predicted(problem)
    return report(problem, solved(settings, problem), prediction)


def diagnosed(
    settings: Settings,
    camera: Result | CameraFile,
    poses: Table,
    targets: Table,
    observations: Table | None = None,
    images: ImageSet | None = None,
    effects: Sequence[Wanted] = (),
) -> Subject:
    """Return the job as diagnosis sees it, with all its readings; raises as `run` does."""
    problem = prepared(settings, camera, poses, Seen(targets, observations, images), effects)
    return subject(problem, solved(replace(settings, outliers="report"), problem))


@dataclass(frozen=True)
class Seen:
    """What was seen of which targets."""

    targets: Table
    observations: Table | None
    images: ImageSet | None


def prepared(
    settings: Settings, camera: Result | CameraFile, poses: Table, seen: Seen, effects: Sequence[Wanted]
) -> Problem:
    """Return the adjustment with its starting values and the effects of the job."""
    model = camera_of(camera)
    if seen.images is not None:
        model.must_fit(seen.images)
    sighted = sightings(settings, seen.observations, seen.targets, seen.images, Needs(fewest=1))
    problem = build(model, sighted, poses, free_angle="clamping-angle" in settings.estimate)
    return problem.with_model(extended(problem.model(), effects)) if effects else problem


def solved(settings: Settings, problem: Problem) -> Adjusted:
    """Adjust a problem; raises UndeterminedError or NotConvergedError where it has no good solution."""
    options = Options(settings.outliers == "remove", settings.noise == "estimated", problem.camera.image_size)
    adjusted = adjust_images(problem.blocks, problem.images, problem.others, None, options)
    solution = adjusted.solution
    if solution.undetermined or solution.outcome is Outcome.TOO_FEW:
        raise UndeterminedError(explained(problem, solution))
    must_converge(solution)
    return adjusted


def simulate(
    settings: Settings,
    options: SimulationOptions,
    camera: Result | CameraFile,
    poses: Table,
    targets: Table,
    effects: Sequence[Wanted] = (),
    **_: object,
) -> Simulation:
    """Return what the camera sees of the part of `simulation:` from each pose, with noise and effects.

    Pictures too if asked for.
    """
    truth = settings.simulation
    if truth is None:
        raise InputError("simulate needs the truth: give `simulation: {part: {x: 10 mm, ...}, clamping_angle: 1 mm/m}`")
    model = camera_of(camera)
    rng = np.random.default_rng(options.seed)
    known = true_targets(known_targets(settings.pattern, targets, 0.0), rng)
    at = np.array([getattr(truth.part, name) for name in EULER])
    held = spindle_poses(poses, range(len(poses)))
    part = pose_from_euler(at[:3], at[3:])
    to_camera = part_in_camera(part, held, truth.clamping_angle, model.taper)
    images, times = tuple(poses.texts("image")), {name: poses.numbers(name) for name in ("t", "temp") if name in poses}
    shown = Shown(model.lens, model.image_size, images, to_camera, known, model.convention, times)
    sigma = settings.noise if isinstance(settings.noise, float) else START_NOISE
    seen = sights(shown)
    seen, values = planted(true_model(model, shown, seen, Truth(part, held, truth.clamping_angle)), seen, effects)
    table = sightings_table(replace(shown, conditions={}), seen, sigma, rng)
    drawn: Iterable[tuple[str, Draw]] = ()
    if options.images and settings.pattern is not None:
        refuse_pictures(effects)
        drawn = pictures(shown, settings.pattern, rng)
    true = dict(zip(EULER, at.tolist(), strict=True)) | {"gamma_s": truth.clamping_angle}
    return Simulation({"observations.csv": table}, true | values, drawn)


__all__ = ["KIND", "SIMULATED", "SUMMARY", "Inputs", "Settings", "run", "simulate"]
