"""The job of a self-calibration: its keys, and the columns of its files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from metrocli.adjust.clusters.robust import FROM_RESIDUALS
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.geometry.rotations import rotation_from_vector
from metrocli.instruments.ball_grid import View
from metrocli.settings import Choice, Either, ListOf, Section, TableFile, Text, Whole, WithUnit, setting
from metrocli.settings.sections import content, inputs_of
from metrocli.table import ABSENT, Columns, Table, columns
from metrocli.tasks.shared.figures import POSE, adjusted
from metrocli.units import parse_quantity

_QUARTER = np.pi / 2
_UNIT = parse_quantity("1 um", "length")
VIEWS = Columns(
    columns("view [text]", "i j k [whole]", "x y z [length]", "repeat? [text]", "t? [time]", "temp? [temperature]"),
    ("view", "i", "j", "k", "repeat", "t"),
    "what the machine reads of each ball in each view",
    measured=("x", "y", "z"),
    alike=("i", "j", "k"),
    group=("view", "repeat"),
)
LENGTHS = Columns(
    columns("view?* [text]", "i1 j1 k1 i2 j2 k2 [whole]", "length sigma [length]"), (), "calibrated distances of balls"
)
POINTS = Columns(columns("point [text]", "x y z [length]"), ("point",), "points at which the machine error is wanted")


@dataclass(frozen=True)
class Files:
    """The files of measured and of known values."""

    views: Table = content(TableFile(VIEWS), default=ABSENT)
    lengths: Table | None = content(TableFile(LENGTHS), needed=False)
    map: Table | None = content(TableFile(POINTS), needed=False)


Inputs = inputs_of(Files)


@dataclass(frozen=True)
class GridSettings:
    """The artefact's grid of balls."""

    size: tuple[int, ...] = setting(ListOf(Whole(1, 201), 3), "balls along i, j, k: odd numbers")
    pitch: float = setting(WithUnit("length", positive=True), "distance of neighbouring balls")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a fault for each even size."""
        for n in self.size:
            if n % 2 == 0:
                yield "size", f"{n} is even; balls are counted from the middle one, so each size is odd"

    @property
    def half(self) -> Index:
        """Largest index in each direction."""
        return np.array(self.size, dtype=np.intp) // 2


@dataclass(frozen=True)
class Rotate:
    """A turn of the artefact about an axis of the machine."""

    axis: str = setting(Choice("x", "y", "z"), "axis of the machine")
    angle: float = setting(WithUnit("angle"), "a multiple of 90 deg, anticlockwise seen against the axis")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a fault if the angle does not bring the grid onto itself."""
        if abs(self.angle / _QUARTER - round(self.angle / _QUARTER)) > 1e-9:
            yield "angle", "only multiples of 90 deg bring the balls back to sites of the grid"

    @property
    def matrix(self) -> Array:
        """The rotation matrix (3, 3), of whole numbers."""
        vector = np.eye(3)["xyz".index(self.axis)] * self.angle
        return np.asarray(np.rint(rotation_from_vector(vector)))


@dataclass(frozen=True)
class ViewSettings:
    """The nominal mounting of the artefact in one view: turned, then shifted."""

    name: str = setting(Text(), "the name in the column `view`")
    rotate: Rotate | tuple[Rotate, ...] = setting(
        Either(Section(Rotate), ListOf(Section(Rotate))), "one turn, or several one after the other", default=()
    )
    shift: tuple[int, ...] = setting(ListOf(Whole(-100, 100), 3), "in pitches along x, y, z", default=(0, 0, 0))

    @property
    def view(self) -> View:
        """The nominal mounting."""
        turn = np.eye(3)
        for rotation in (self.rotate,) if isinstance(self.rotate, Rotate) else self.rotate:
            turn = rotation.matrix @ turn
        return View(self.name, turn, np.array(self.shift, dtype=float))


@dataclass(frozen=True)
class GridSimulation:
    """The truth that `metrocli simulate` draws."""

    machine_error: float = setting(WithUnit("length", minimum=0.0), "largest error of the machine", default=0.017)
    artefact_error: float = setting(
        WithUnit("length", minimum=0.0), "standard deviation of the balls' places", default=0.3
    )
    shift: float = setting(WithUnit("length", minimum=0.0), "standard deviation of each mounting's shift", default=0.2)
    tilt: float = setting(WithUnit("angle", minimum=0.0), "standard deviation of each mounting's turn", default=1e-3)
    repeats: int = setting(Whole(1, 100), "times that each ball is measured in each view", default=1)
    interval: float = setting(WithUnit("time", positive=True), "time from ball to ball", default=20.0)


@dataclass(frozen=True)
class Settings:
    """Find the errors of machine and artefact from views of an artefact that nobody calibrated."""

    ELSEWHERE: ClassVar[Mapping[str, str]] = {
        "part": "no part is measured here; the growth of the artefact is the effect artefact-expansion"
    }

    inputs: Any = setting(Section(Inputs), "the files of the job")
    grid: GridSettings = setting(Section(GridSettings), "the artefact")
    views: tuple[ViewSettings, ...] = setting(ListOf(Section(ViewSettings)), "how the artefact stood")
    noise: float | str = setting(
        Either(WithUnit("length", positive=True), Choice(*FROM_RESIDUALS)),
        "standard deviation of each coordinate of a ball, or 'estimated' from the residuals, "
        "or 'structured': estimated, and readings taken one after the other may share errors",
    )
    outliers: str = setting(Choice("report", "remove"), "name outliers, or leave them out", default="report")
    leave_one_out: str = setting(
        Choice("auto", "yes", "no"), "adjust again without each view; auto: up to 20,000 readings", default="auto"
    )
    simulation: GridSimulation | None = setting(
        Section(GridSimulation), "the truth for `metrocli simulate`", default=None
    )

    @property
    def declared(self) -> float:
        """The declared noise [mm], or 1 um as a starting value if the noise is to be estimated."""
        return _UNIT if isinstance(self.noise, str) else self.noise

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a fault for an empty list of views and for each name of more than one view."""
        names = [view.name for view in self.views]
        if not names:
            yield "views", "there is no view"
        for name in sorted({name for name in names if names.count(name) > 1}):
            yield "views", f"two views have the name '{name}'"


def views_of(settings: Settings) -> list[View]:
    """Return the nominal mountings."""
    return [view.view for view in settings.views]


def turn_in_words(turn: Array) -> str:
    """Return a rotation matrix of whole numbers in words: 'turned by 90 deg about z'."""
    for axis in "xyz":
        for degrees, angle in ((90, _QUARTER), (180, 2 * _QUARTER), (-90, -_QUARTER)):
            if np.array_equal(Rotate(axis, angle).matrix, turn):
                return f"turned by {degrees} deg about {axis}"
    if np.array_equal(turn, np.eye(3)):
        return "not turned"
    names = [f"{'-' if row[np.argmax(np.abs(row))] < 0 else ''}{'ijk'[np.argmax(np.abs(row))]}" for row in turn]
    return f"turned so that x, y, z run along {', '.join(names)} of the artefact"


def shift_in_words(shift: Sequence[float] | Array) -> str:
    """Return a shift in pitches in words: '[1, 0, 0]'."""
    return f"[{', '.join(str(round(value)) for value in shift)}]"


_FIELDS = (
    "largest_machine_error.mm", "rms_machine_error.mm", "rms_artefact_error.mm", "largest_length_error.mm",
    "largest_length_error_std.mm",
)  # fmt: skip
"""Of error fields that the views determine completely"""


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures: the mounting of each view, and statistics."""
    mounting = {f"{{view}}.{name}": unit for name, unit in POSE.items()}
    statistics = ("undetermined", "noise_gain", "rejected", "critical_w", "noise.mm")
    return adjusted(mounting, (*statistics, *_FIELDS), ["mm"])
