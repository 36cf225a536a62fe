"""The keys of a calibrate-camera job, and the columns of its files."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

from metrocli.adjust.clusters import robust
from metrocli.adjust.clusters.robust import ESTIMATED, FROM_RESIDUALS, STRUCTURED
from metrocli.frozen import dataclass
from metrocli.imageset import ImageSet
from metrocli.instruments.lenses.lens import PARAMETERS, UNITS
from metrocli.settings import (
    Choice,
    Either,
    ImageFiles,
    ListOf,
    MapOf,
    Section,
    TableFile,
    Text,
    Whole,
    WithUnit,
    setting,
)
from metrocli.settings.sections import content, inputs_of
from metrocli.table import Columns, Table, columns
from metrocli.targets.pattern import Pattern, board_in_words
from metrocli.tasks.calibrate_camera.multi_camera.truth import CameraSimulation
from metrocli.tasks.shared.figures import POSE, adjusted
from metrocli.tasks.shared.images.search import OBSERVATIONS
from metrocli.tasks.shared.images.settings import (
    ESTIMATE,
    SPLINE,
    LensModel,
    eccentricity_setting,
    image_faults,
    shutter_setting,
    targets_setting,
)
from metrocli.tasks.shared.images.target_list import TARGETS
from metrocli.tasks.shared.noise import NOISE_HELP

SCALE_BARS = Columns(columns("from to [text]", "length sigma [length]"), ("from", "to"), "calibrated distances")
TEST_LENGTHS = Columns(
    columns("from to [text]", "length sigma [length]", "line? [text]"),
    ("from", "to"),
    "calibrated lengths that test the network",
)


@dataclass(frozen=True)
class LengthLimit:
    """The limit of the length measuring error, `A + K L`, at most B (VDI/VDE 2634 part 1)."""

    constant: float = setting(WithUnit("length", minimum=0.0), "A: the constant part")
    proportional: float = setting(WithUnit("ratio", minimum=0.0), "K: the part proportional to the length", default=0.0)
    at_most: float | None = setting(WithUnit("length", positive=True), "B: the limit of long lengths", default=None)

    def of(self, lengths: Any) -> Any:
        """Return the limit for lengths (n,) [mm]."""
        limit = self.constant + self.proportional * lengths
        return limit if self.at_most is None else limit.clip(max=self.at_most)

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for a limit of zero."""
        if self.constant == 0.0 and self.proportional == 0.0:
            yield "constant", "the limit is zero for every length: give constant or proportional"


FEWEST = {"board": 4, "cmm": 1, "network": 4}
"""Fewest targets of an image, for each rig"""
_USUAL = {"fisheye": ("k1", "k2", "k3", "k4"), "division": ("k4",)}
"""Distortion that is estimated unless the job names others"""


@dataclass(frozen=True, kw_only=True)
class CameraSettings(LensModel):
    """The camera to calibrate; a given parameter is known, or the starting value if it is estimated too."""

    image_size: tuple[int, int] | None = setting(
        ListOf(Whole(minimum=2, maximum=100_000), length=2),
        "width and height in pixels; read from the images where there are any",
        default=None,
    )
    pixel_size: float | None = setting(
        WithUnit("length", positive=True), "side of a pixel, for results in mm", default=None
    )
    estimate: tuple[str, ...] = setting(
        ListOf(Choice(*PARAMETERS), distinct=True),
        "parameters to estimate; f cx cy k1 k2 p1 p2 unless given, k1 to k4 for a fisheye, k4 for division",
        default=None,
    )
    reference_radius: float | None = setting(
        WithUnit("length"),
        "R0 of the balanced photogrammetric form; 2/3 of the largest radius unless given",
        default=None,
    )

    base: str = setting(Choice("opencv", "fisheye"), "the lens that a spline shifts", default="opencv")

    @property
    def formula(self) -> str:
        """Return the model that its parameters belong to: that of the base of a spline."""
        return self.base if self.model == SPLINE else super().formula

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.estimate is None:
            usual = _USUAL.get(self.formula, ("k1", "k2", "p1", "p2"))
            object.__setattr__(self, "estimate", ("f", "cx", "cy", *usual))

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for keys that contradict each other."""
        chosen = set(self.estimate) | set(self.given())
        yield from self.model_faults(chosen, "estimate")
        if self.base != "opencv" and self.model != SPLINE:
            yield "base", "base is the lens that a spline shifts: write model: spline"
        if "f" in chosen and chosen & {"fx", "fy"}:
            yield "estimate", "f is one focal length for both axes: name either f, or fx and fy"
        if "aspect" in chosen and chosen & {"fx", "fy"}:
            yield "estimate", "aspect goes with f: fx and fy already determine the ratio"
        if not chosen & {"f", "fx", "fy"}:
            yield "estimate", "the focal length is neither estimated nor given: add f to estimate, or give f: ... px"
        if len(chosen & {"fx", "fy"}) == 1:
            yield "estimate", "fx and fy come together"
        if self.reference_radius is not None and self.pixel_size is None:
            yield "reference_radius", "reference_radius needs pixel_size"


@dataclass(frozen=True, kw_only=True)
class OneOfSeveral(CameraSettings):
    """One of several cameras that are fixed to each other."""

    images: str = setting(
        Text(), "names of its images, with one *: images of two cameras are taken at once if it stands for the same"
    )

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for keys that contradict each other."""
        yield from super().faults()
        if self.images.count("*") != 1:
            yield "images", "images has not one *, such as left*.jpg: what it stands for names the exposure"


@dataclass(frozen=True)
class Files:
    """Image points and targets, or images and a pattern."""

    observations: Table | None = content(TableFile(OBSERVATIONS), needed=False)
    targets: Table | None = content(TableFile(TARGETS), needed=False)
    images: ImageSet | None = content(ImageFiles(), "images, such as img/*.jpg, instead of observations", needed=False)
    scale_bars: Table | None = content(
        TableFile(SCALE_BARS), "calibrated distances between targets (rig network)", needed=False
    )
    test_lengths: Table | None = content(
        TableFile(TEST_LENGTHS),
        "calibrated distances between targets that take no part in the adjustment and test it (rig network)",
        needed=False,
    )


Inputs = inputs_of(Files)


@dataclass(frozen=True)
class Settings:
    """Calibrate a camera: focal length, principal point and distortion, with their covariance."""

    ELSEWHERE: ClassVar[Mapping[str, str]] = {
        "part": "a network gives points as warm as they were: give `part:` in the fit-part job that reads them"
    }

    rig: str = setting(
        Choice("board", "cmm", "network"),
        "board: a target board in unknown poses; cmm: targets placed by a CMM; network: unknown points and poses",
    )
    inputs: Any = setting(Section(Inputs), "the files of the job")
    noise: float | str = setting(
        Either(WithUnit("pixel", positive=True, minimum=1e-9), Choice(*FROM_RESIDUALS)), NOISE_HELP
    )
    camera: CameraSettings = setting(Section(CameraSettings), "the camera", default=CameraSettings())
    cameras: dict[str, OneOfSeveral] | None = setting(
        MapOf(Section(OneOfSeveral)), "several cameras that are fixed to each other, by name", default=None
    )
    pattern: Pattern | None = setting(Section(Pattern), "what the images show", default=None)
    outliers: str = setting(
        Choice("report", "remove"), "name outliers, or leave them out and list them", default="report"
    )

    targets: str = targets_setting()
    eccentricity: str = eccentricity_setting()
    shutter: str = shutter_setting()
    length_limit: LengthLimit | None = setting(
        Section(LengthLimit), "largest length measuring error that is allowed, for the test lengths", default=None
    )
    simulation: CameraSimulation | None = setting(
        Section(CameraSimulation), "the truth for `metrocli simulate`", default=None
    )

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for inputs that are missing or contradict each other."""
        yield from image_faults(self.inputs.observations, self.inputs.images, self.pattern, self.inputs.targets)
        yield from self._of_cameras()
        yield from self._of_simulation()
        if self.cameras is None and self.inputs.observations is not None and self.camera.image_size is None:
            yield (
                "camera",
                "image_size is missing: a table of observations does not contain it; "
                "write e.g. image_size: [2592, 1944]",
            )
        if self.targets == ESTIMATE and self.rig == "cmm":
            yield "targets", "rig: cmm sees each target from one place, so their coordinates have to be known"
        if self.inputs.scale_bars is not None and self.rig != "network":
            yield "inputs.scale_bars", "scale bars belong to rig: network"
        if self.inputs.test_lengths is not None and self.rig != "network":
            yield "inputs.test_lengths", "test lengths belong to rig: network"
        if self.length_limit is not None and self.inputs.test_lengths is None:
            yield "length_limit", "a limit needs the lengths it is for: give `inputs: test_lengths`"

    def _of_cameras(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for several cameras that cannot be calibrated together."""
        if self.cameras is None:
            return
        if len(self.cameras) < 2:
            yield "cameras", "cameras are two or more: write a single one as camera: {...}"
        if self.camera != CameraSettings():
            yield "camera", "both camera and cameras are given: write each camera under cameras"
        if len({"fx" in camera.estimate or "fx" in camera.given() for camera in self.cameras.values()}) > 1:
            yield "cameras", "either all cameras have f, or all have fx and fy"
        if self.rig == "cmm" and any(camera.model == SPLINE for camera in self.cameras.values()):
            yield (
                "rig",
                "rig: cmm takes the model spline of a single camera: calibrate that alone, or give another model",
            )
        for name, several in self.cameras.items():
            if self.inputs.observations is not None and several.image_size is None:
                yield f"cameras.{name}", "image_size is missing: a table of observations does not contain it"

    def _of_simulation(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for a truth that is not that of the cameras."""
        if self.simulation is None:
            return
        truth, names = self.simulation.cameras, list(self.cameras or {})
        if list(truth or {}) != names:
            yield "simulation.cameras", f"the truth is that of {', '.join(names) or 'a single camera: write lens'}"
            return
        for number, (name, true_camera) in enumerate((truth or {}).items()):
            if (true_camera.extrinsics is None) is (number > 0):
                where = (
                    "needs extrinsics, its place in the frame of the first"
                    if number
                    else "is the frame: leave extrinsics out"
                )
                yield f"simulation.cameras.{name}", f"{name} {where}"


def job_of(images: str, board: str, output: str, count: int) -> str:
    """Return the text of the job of images, so many, and the board that they show.

    Its noise is structured where there are enough images. Raises UsageError as `board_in_words`.
    """
    pattern = ", ".join(f"{key}: {value}" for key, value in board_in_words(board).items())
    # uncertainties for white noise are too small on real boards (docs/decisions/265-a-first-job-is-structured.md)
    white = f"{ESTIMATED}  # uncertainties are too small; {robust.FEWEST} images or more allow {STRUCTURED}"
    noise = STRUCTURED if count >= robust.FEWEST else white
    return (
        f"metrocli: 1\njob: calibrate-camera\nrig: board\ninputs: {{images: {json.dumps(images)}}}\n"
        f"pattern: {{{pattern}}}\nnoise: {noise}\noutput: {json.dumps(output)}\n"
    )


_STATISTICS = (
    "noise", "rank", "rms_u", "rms_v", "readings", "rejected", "images", "targets", "coverage_cells", "coverage_hull",
    "coverage_radius", "corner_std", "shape_rms", "sigma0_low", "sigma0_high", "condition", "image_width",
    "image_height", "pixel_size",
)  # fmt: skip
_LENGTHS = ("test_lengths", "length_measuring_error", "length_max_en", "length_error_over_limit")
"""Of lengths that test the network"""


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures; the pose is there with rig cmm, and of each of several cameras."""
    own = {name: UNITS.get(name, "1") for name in PARAMETERS} | POSE
    if settings.cameras is not None:
        own = {f"{camera}.{name}": unit for camera in settings.cameras for name, unit in own.items()}
    return adjusted(own, (*_STATISTICS, *_LENGTHS), ["px"])
