"""Settings of a best fit of points to points, and the columns of its files."""

from __future__ import annotations

from typing import Any

from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.result import Result
from metrocli.settings import Choice, Either, FileOf, Flag, LocatedValue, Section, TableFile, WithUnit, setting
from metrocli.settings.sections import content, inputs_of
from metrocli.table import ABSENT, Columns, Table, columns
from metrocli.tasks.shared.features.requested import features_through
from metrocli.tasks.shared.figures import POSE, adjusted
from metrocli.tasks.shared.lists import SIGMAS

ESTIMATED = "estimated"
COVARIANCES = ("cov_xy_mm2", "cov_xz_mm2", "cov_yz_mm2")
"""Columns of the covariances between the coordinates of a point [mm^2]"""
_KNOWN = (*SIGMAS, *columns(*(f"{name}?*" for name in COVARIANCES)))
_RESULTS = FileOf(("adjust-network", "multilaterate", "calibrate-camera", "fit-points"))
"""Kinds whose results are points with their joint covariance"""
POINTS = Columns(
    (*columns("station? point [text]", "x y z [length]", "feature?* [text]"), *_KNOWN),
    ("station", "point"),
    "points as measured",
    measured=("x", "y", "z"),
)
NOMINAL = Columns(
    (*columns("point [text]", "x?* y?* z?* [length]"), *_KNOWN),
    ("point",),
    "places that the points should have; an empty coordinate is not used",
)


@dataclass(frozen=True)
class Files:
    """The points as measured, and where they should be."""

    points: Table | Result = content(Either(TableFile(POINTS), _RESULTS), POINTS.description, default=ABSENT)
    nominal: Table | Result | None = content(Either(TableFile(NOMINAL), _RESULTS), NOMINAL.description, needed=False)

    @property
    def stations(self) -> bool:
        """Whether the measured points are of several stations."""
        return isinstance(self.points, Table) and "station" in self.points


Inputs = inputs_of(Files)


@dataclass(frozen=True)
class Settings:
    """Lay measured points onto nominal ones by rotation and shift, and a scale if wanted; features through them."""

    inputs: Any = setting(Section(Inputs), "the files of the job")
    noise: float | str = setting(
        Either(WithUnit("length", positive=True), Choice(ESTIMATED)),
        "standard deviation of a coordinate without sigma_mm; or estimated from the residuals",
        default=ESTIMATED,
    )
    scale: bool = setting(Flag(), "estimate a scale too, 7 parameters", default=False)
    features: dict[str, LocatedValue] = features_through("the points, as measured or after the best fit")


def refuse_nothing_to_do(settings: Settings, files: Files) -> None:
    """Raise InputError if there is nothing to lay points onto, and no feature to lay through them."""
    if files.nominal is not None or files.stations:
        return
    what = "name the `nominal` points of a best fit, or `features` to lay through the points; or have stations"
    if not settings.features:
        raise InputError(f"inputs: {what}")
    if settings.scale:
        raise InputError("scale: a scale needs `nominal` points, or stations: leave it out")


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures: pose, scale, features and statistics."""
    from metrocli.tasks.shared.features.report import figures_of

    each = POSE | ({"scale": "1"} if settings.scale else {})
    fitted = (each if settings.inputs.nominal is not None else {}) | {f"{{station}}.{k}": u for k, u in each.items()}
    return adjusted(fitted | figures_of(settings.features), ("noise", "mirrored_rms", "points", "features"), ["mm"])
