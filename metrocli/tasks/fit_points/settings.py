"""Settings of a best fit of points to points, and the columns of its files."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from metrocli.frozen import dataclass
from metrocli.settings import Choice, Either, Flag, Section, TableFile, WithUnit, setting
from metrocli.settings.sections import content, inputs_of
from metrocli.table import ABSENT, Columns, Table, columns
from metrocli.tasks.shared.figures import POSE, adjusted
from metrocli.tasks.shared.lists import SIGMAS

ESTIMATED = "estimated"
POINTS = Columns(
    (*columns("point [text]", "x y z [length]"), *SIGMAS),
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
    nominal: Table = content(TableFile(NOMINAL), default=ABSENT)


Inputs = inputs_of(Files)


@dataclass(frozen=True)
class Settings:
    """Lay measured points onto nominal ones by rotation and shift, and a scale if wanted."""

    inputs: Any = setting(Section(Inputs), "the files of the job")
    noise: float | str = setting(
        Either(WithUnit("length", positive=True), Choice(ESTIMATED)),
        "standard deviation of a coordinate of a nominal point without sigma_mm; or estimated from the residuals",
        default=ESTIMATED,
    )
    scale: bool = setting(Flag(), "estimate a scale too, 7 parameters", default=False)

    def faults(self) -> Iterable[tuple[str, str]]:
        """Nothing: each key stands for itself."""
        return ()


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures: pose, scale and statistics."""
    return adjusted(POSE | ({"scale": "1"} if settings.scale else {}), ("noise", "mirrored_rms", "points"), ["mm"])
