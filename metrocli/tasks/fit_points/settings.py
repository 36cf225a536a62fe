"""Settings of a best fit of points to points, and the columns of its files."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from metrocli.frozen import dataclass
from metrocli.settings import Choice, Either, Flag, LocatedValue, Section, TableFile, WithUnit, setting
from metrocli.settings.sections import content, inputs_of
from metrocli.table import ABSENT, Columns, Table, columns
from metrocli.tasks.shared.features.settings import features_through
from metrocli.tasks.shared.figures import POSE, adjusted
from metrocli.tasks.shared.lists import SIGMAS

ESTIMATED = "estimated"
POINTS = Columns(
    (*columns("point [text]", "x y z [length]", "feature?* [text]"), *SIGMAS),
    ("point",),
    "points as measured",
    measured=("x", "y", "z"),
)
NOMINAL = Columns(
    (*columns("point [text]", "x?* y?* z?* [length]"), *SIGMAS),
    ("point",),
    "places that the points should have; an empty coordinate is not used",
)


@dataclass(frozen=True)
class Files:
    """The points as measured, and where they should be."""

    points: Table = content(TableFile(POINTS), default=ABSENT)
    nominal: Table | None = content(TableFile(NOMINAL), needed=False)


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

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield that there is nothing to do, or a scale without nominal points."""
        if self.inputs.nominal is None and not self.features:
            yield "inputs", "name the `nominal` points of a best fit, or `features` to lay through the points"
        if self.inputs.nominal is None and self.scale:
            yield "scale", "a scale needs `nominal` points: leave it out"


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures: pose, scale, features and statistics."""
    from metrocli.tasks.shared.features.report import figures_of

    fitted = POSE | ({"scale": "1"} if settings.scale else {}) if settings.inputs.nominal is not None else {}
    return adjusted(fitted | figures_of(settings.features), ("noise", "mirrored_rms", "points", "features"), ["mm"])
