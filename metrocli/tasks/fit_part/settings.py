"""The keys of a fit-part job, of its ideal part, and the columns of its points."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from metrocli.frozen import dataclass
from metrocli.geometry.triangles import Triangles
from metrocli.result import Result
from metrocli.settings import (
    Choice,
    Either,
    FileOf,
    ListOf,
    MapOf,
    MeshFile,
    Number,
    Section,
    TableFile,
    Text,
    Whole,
    WithUnit,
    setting,
)
from metrocli.settings.sections import content, inputs_of
from metrocli.table import ABSENT, Columns, Table, columns
from metrocli.tasks.fit_part.fit import EVEN, LEAST_MOTION, MOST
from metrocli.tasks.shared.figures import POSE, with_std
from metrocli.tasks.shared.lists import SIGMAS
from metrocli.tasks.shared.part import FIGURES, Part
from metrocli.words import in_a_row

POINTS = Columns(
    (*columns("point [text]", "x y z [length]", "surface?* [text]"), *SIGMAS),
    key=("point",),
    description="points measured on the raw part, and coded targets",
)
PLANE, CYLINDER, SPHERE, CONE = "plane", "cylinder", "sphere", "cone"
_KEYS = {
    PLANE: {"normal"},
    CYLINDER: {"axis", "radius", "material"},
    SPHERE: {"radius", "material"},
    CONE: {"axis", "half_angle", "material"},
}
"""Keys of each type of surface beside name, type and point"""
SIZES = {"mm": 1.0, "m": 1000.0, "um": 1e-3, "cm": 10.0, "inch": 25.4}
"""Units of a mesh, in mm"""


@dataclass(frozen=True, kw_only=True)
class SurfaceEntry:
    """One ideal surface."""

    name: str = setting(Text(), "name, as in the column `surface` of the points")
    type: str = setting(Choice(*_KEYS), "type of the surface")
    point: tuple[float, ...] = setting(
        ListOf(WithUnit("length"), 3), "a point of a plane or of an axis, the centre of a sphere, the apex of a cone"
    )
    normal: tuple[float, ...] | None = setting(ListOf(Number(), 3), "plane: direction out of the material", None)
    axis: tuple[float, ...] | None = setting(
        ListOf(Number(), 3), "direction of the axis; a cone widens along it", default=None
    )
    radius: float | None = setting(WithUnit("length", positive=True), "radius", default=None)
    half_angle: float | None = setting(
        WithUnit("angle", positive=True), "cone: angle between axis and surface", default=None
    )
    material: str | None = setting(
        Choice("inside", "outside"), "side of the material: inside (a boss) or outside (a bore)", default=None
    )

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for keys that do not belong to the type, and directions of length 0."""
        given = {
            key for key in ("normal", "axis", "radius", "half_angle", "material") if getattr(self, key) is not None
        }
        missing, extra = _KEYS[self.type] - given, given - _KEYS[self.type]
        if missing:
            yield "type", f"a {self.type} also needs {in_a_row(sorted(missing))}"
        for key in sorted(extra):
            yield key, f"a {self.type} has no {key}"
        for key in ("normal", "axis"):
            vector = getattr(self, key)
            if vector is not None and not any(vector):
                yield key, f"the {key} is a direction and cannot be [0, 0, 0]"
        if self.half_angle is not None and self.half_angle >= 1.57:
            yield "half_angle", "the half angle of a cone is below 90 deg"


@dataclass(frozen=True)
class NominalFile:
    """The ideal part as surfaces without limits."""

    surfaces: tuple[SurfaceEntry, ...] = setting(ListOf(Section(SurfaceEntry)), "planes, cylinders, cones and spheres")

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for names that are used twice."""
        names = [surface.name for surface in self.surfaces]
        for name in sorted({name for name in names if names.count(name) > 1}):
            yield "surfaces", f"two surfaces have the name '{name}'"
        if not names:
            yield "surfaces", "there is no surface"


@dataclass(frozen=True)
class Files:
    """The measured points and the ideal part."""

    nominal: NominalFile | Triangles = content(
        Either(FileOf(section=NominalFile), MeshFile()), "ideal part: surfaces (.yaml) or a mesh (.stl, .ply, .obj)"
    )
    points: Table | Result = content(
        Either(TableFile(POINTS), FileOf(("calibrate-camera", "multilaterate", "adjust-network"))),
        "points on the raw part (CSV), or the result that measured them",
        default=ABSENT,
    )


Inputs = inputs_of(Files)


@dataclass(frozen=True)
class Overstock:
    """What the ideal part must keep inside the raw part."""

    minimum: float = setting(WithUnit("length"), "least overstock everywhere")
    aim: str = setting(
        Choice(EVEN, MOST, LEAST_MOTION),
        "least variation of the overstock, largest least overstock, or least motion of the points",
        default=EVEN,
    )


@dataclass(frozen=True, kw_only=True)
class PartStart:
    """Rough pose of the ideal part: `X_measured = R(alpha, beta, gamma) X_part + (x, y, z)`."""

    x: float = setting(WithUnit("length"), "x of the part's origin", default=0.0)
    y: float = setting(WithUnit("length"), "y of the part's origin", default=0.0)
    z: float = setting(WithUnit("length"), "z of the part's origin", default=0.0)
    alpha: float = setting(WithUnit("angle"), "turn about x, first", default=0.0)
    beta: float = setting(WithUnit("angle"), "turn about y, second", default=0.0)
    gamma: float = setting(WithUnit("angle"), "turn about z, third", default=0.0)


@dataclass(frozen=True)
class FitTrials:
    """A check of the uncertainties by fits to points with simulated errors."""

    trials: int = setting(Whole(minimum=20, maximum=100_000), "number of fits", default=200)
    seed: int = setting(Whole(minimum=0), "seed of the random numbers", default=1)


@dataclass(frozen=True)
class Settings:
    """Lay the ideal part into a measured raw part, with the minimum overstock everywhere."""

    inputs: Any = setting(Section(Inputs), "the files of the job")
    overstock: Overstock = setting(Section(Overstock), "the overstock that is wanted")
    targets: tuple[str, ...] = setting(
        ListOf(Text()), "names of coded targets among the points, such as T*, which are not points of a surface", ()
    )
    surfaces: Mapping[str, tuple[str, ...]] = setting(
        MapOf(ListOf(Text())), "names of the points of a surface, such as top: [P1*], instead of a column", {}
    )
    noise: float | None = setting(
        WithUnit("length", positive=True), "standard deviation of a coordinate, for points without one", default=None
    )
    start: PartStart = setting(Section(PartStart), "where the ideal part lies, roughly", default=PartStart())
    part: Part | None = setting(
        Section(Part), "temperature and expansion of the raw part when its points were measured", default=None
    )
    nominal_unit: str = setting(Choice(*SIZES), "unit of the coordinates in a mesh", default="mm")
    outliers: str = setting(
        Choice("report", "remove"), "chips and flash: name them, or leave them out and list them", default="remove"
    )
    monte_carlo: FitTrials | None = setting(
        Section(FitTrials), "check of the uncertainties by simulated errors", default=None
    )


_STATISTICS = (
    "observations", "unknowns", "dof", "iterations", "minimum", "least_overstock", "mean_overstock",
    "largest_overstock", "variation", "largest_least_overstock", "optimality", "active", "rejected", "targets",
    "monte_carlo_trials", "monte_carlo_failed", *FIGURES,
)  # fmt: skip


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures."""
    return with_std(POSE) | dict.fromkeys(_STATISTICS, "")
