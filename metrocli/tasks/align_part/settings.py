"""The keys of an align-part job, and the columns of its files."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from metrocli.adjust.clusters.robust import FROM_RESIDUALS
from metrocli.frozen import dataclass
from metrocli.imageset import ImageSet
from metrocli.result import Result
from metrocli.settings import (
    Choice,
    Either,
    FileOf,
    ImageFiles,
    ListOf,
    MapOf,
    Section,
    TableFile,
    Text,
    WithUnit,
    setting,
)
from metrocli.settings.sections import content, inputs_of
from metrocli.table import Columns, Table, columns
from metrocli.targets.pattern import Pattern
from metrocli.tasks.align_part.fixturing import SUPPORTS
from metrocli.tasks.shared.figures import POSE, adjusted
from metrocli.tasks.shared.images.search import OBSERVATIONS
from metrocli.tasks.shared.images.settings import (
    CAMERA_FILES,
    CameraFile,
    Extrinsics,
    OfCameraFile,
    eccentricity_setting,
    image_faults,
    shutter_setting,
    targets_setting,
)
from metrocli.tasks.shared.images.target_list import TARGETS
from metrocli.tasks.shared.noise import NOISE_HELP
from metrocli.tasks.shared.part import Part
from metrocli.units.parsing import Range, range_of

POSES = Columns(
    columns("image [text]", "x y z [length]", "a? b? c? [angle]", "t? [time]", "temp? [temperature]"),
    ("image",),
    "commanded poses of the spindle",
)

_SIGMA = columns("sigma? [length]", allowed=Range(0.0, range_of("length").high))
POINTS = Columns(
    (*columns("point [text]", "x y z [length]"), *_SIGMA),
    ("point",),
    "points of the part, in its frame",
)


@dataclass(frozen=True)
class Files:
    """The camera, the spindle's poses, the targets, and their image points or the images."""

    camera: Result | CameraFile = content(
        FileOf(("calibrate-camera",), CameraFile, CAMERA_FILES),
        "result of calibrate-camera (rig cmm), of one camera or several, or a camera written by hand (.yaml) or by "
        "another program",
    )
    poses: Table = content(TableFile(POSES), "commanded pose of the spindle for each image")
    targets: Table | Result = content(
        Either(TableFile(TARGETS), FileOf(("fit-part", "adjust-network"))),
        "coordinates of targets in the part (CSV), or the result of fit-part or adjust-network that has them",
    )
    machine: Result | None = content(
        FileOf(("calibrate-machine",)),
        "result of calibrate-machine, by whose errors the poses of the spindle are corrected",
        needed=False,
    )
    supports: Table | None = content(
        TableFile(SUPPORTS), "supports that raise the part along z of the machine", needed=False
    )
    points: Table | None = content(
        TableFile(POINTS), "points of the part whose places in the machine are predicted, to gauge them", needed=False
    )
    observations: Table | None = content(TableFile(OBSERVATIONS), needed=False)
    images: ImageSet | None = content(ImageFiles(), "images, such as img/*.png, instead of observations", needed=False)


Inputs = inputs_of(Files)


@dataclass(frozen=True, kw_only=True)
class AlignSimulation:
    """The truth that `metrocli simulate` starts from."""

    part: Extrinsics = setting(Section(Extrinsics), "the part in the machine")
    clamping_angle: float = setting(
        Either(WithUnit("angle"), WithUnit("slope")), "true clamping angle gamma_s", default=0.0
    )


@dataclass(frozen=True)
class Settings:
    """Locate a part in the machine from images of a camera in the spindle (6D), with its clamping angle (7D)."""

    inputs: Any = setting(Section(Inputs), "the files of the job")
    noise: float | str = setting(
        Either(WithUnit("pixel", positive=True, minimum=1e-9), Choice(*FROM_RESIDUALS)),
        NOISE_HELP,
    )
    estimate: tuple[str, ...] = setting(
        ListOf(Choice("part-pose", "clamping-angle"), distinct=True),
        "unknowns: the 6D or the 7D job",
        default=("part-pose", "clamping-angle"),
    )
    camera: OfCameraFile | None = setting(
        Section(OfCameraFile),
        "what the camera file does not state: its place in the taper, uncertainties",
        default=None,
    )
    cameras: dict[str, str] | None = setting(
        MapOf(Text()),
        "names of the images of each of several cameras, with one *, as in their calibration unless given; images are "
        "taken at once if it stands for the same",
        default=None,
    )
    part: Part | None = setting(
        Section(Part), "temperature and expansion of the part in the machine; its targets are listed at 20 degC", None
    )
    pattern: Pattern | None = setting(Section(Pattern), "what the images show", default=None)
    outliers: str = setting(
        Choice("report", "remove"), "name outliers, or leave them out and list them", default="report"
    )
    targets: str = targets_setting()
    eccentricity: str = eccentricity_setting()
    shutter: str = shutter_setting()
    simulation: AlignSimulation | None = setting(
        Section(AlignSimulation), "the truth for `metrocli simulate`", default=None
    )

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for keys that are missing or contradict each other."""
        yield from image_faults(self.inputs.observations, self.inputs.images, self.pattern, self.inputs.targets)
        for name, shape in (self.cameras or {}).items():
            if shape.count("*") != 1:
                yield f"cameras.{name}", f"'{shape}' has not one *: write names of images such as {name}*.png"
        if "part-pose" not in self.estimate:
            yield "estimate", "part-pose is missing: write [part-pose] for 6D or [part-pose, clamping-angle] for 7D"


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures; `gamma_s` is there only with rotated poses or a free clamping angle."""
    statistics = ("readings", "rejected", "images", "noise", "predicted_std_gamma_s", "predicted_correlation_gamma_s")
    estimates = POSE | {"gamma_s": "rad", "part-expansion.scale": "1"}
    return adjusted(estimates, statistics, ["px"])
