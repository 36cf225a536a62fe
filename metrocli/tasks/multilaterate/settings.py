"""Settings of a multilaterate job, and the columns of its files."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from metrocli.frozen import dataclass
from metrocli.settings import Choice, LocatedValue, Section, TableFile, WithUnit, setting
from metrocli.settings.sections import content, inputs_of
from metrocli.table import ABSENT, Columns, Table, columns
from metrocli.tasks.shared.environment import WEATHER, Environment
from metrocli.tasks.shared.features.requested import features_through
from metrocli.tasks.shared.figures import adjusted
from metrocli.tasks.shared.lengths import LengthNoise, Scale
from metrocli.tasks.shared.lists import SIGMAS
from metrocli.tasks.shared.part import FIGURES, Part

LENGTHS = Columns(
    (*columns("point tracer [text]", "length [length]", "t? [time]", "temp? [temperature]"), *WEATHER),
    ("point", "tracer", "t"),
    "lengths read by the tracers",
    measured=("length",),
    alike=("tracer",),
)
POINTS = Columns(
    (*columns("point [text]", "x y z [length]"), *SIGMAS, *columns("tip? [text]")),
    ("point",),
    "approximate points: the mover's readings",
)
TRACERS = Columns(
    (*columns("tracer [text]", "x y z [length]", "dead_path?* [length]"), *SIGMAS),
    ("tracer",),
    "approximate places of the tracers",
)
CANDIDATES = Columns(
    columns("candidate [text]", "x y z [length]"),
    ("candidate",),
    "places where one more tracer could stand, for `plan`",
)
PROBING = Columns(
    columns("feature point* tip? [text]", "x y z [length]"),
    (),
    "the mover's readings on the workpiece",
)
TIPS = Columns(
    (*columns("tip [text]", "x y z [length]"), *SIGMAS), ("tip",), "probe tips, from the mover's reference point"
)
DISTANCES = Columns(
    columns("from to [text]", "length sigma [length]"),
    ("from", "to"),
    "calibrated distances between points",
)


@dataclass(frozen=True)
class Files:
    """The lengths that the tracers read, and the mover's readings of the points."""

    lengths: Table = content(TableFile(LENGTHS), default=ABSENT)
    points: Table = content(TableFile(POINTS), default=ABSENT)
    tracers: Table | None = content(TableFile(TRACERS), needed=False)
    probing: Table | None = content(TableFile(PROBING), needed=False)
    tips: Table | None = content(TableFile(TIPS), needed=False)
    distances: Table | None = content(TableFile(DISTANCES), needed=False)
    candidates: Table | None = content(TableFile(CANDIDATES), needed=False)


Inputs = inputs_of(Files)


@dataclass(frozen=True)
class LengthSimulation:
    """The truth for `metrocli simulate`; the tracers stand at their listed places."""

    mover_error: float = setting(
        WithUnit("length", minimum=0.0), "standard deviation of the mover's readings", default=0.0
    )
    mover_scale: float = setting(WithUnit("ratio"), "relative error of the distances that the mover reads", default=0.0)
    tracer_error: float = setting(
        WithUnit("length", minimum=0.0), "standard deviation of the tracers' places in the file written", default=0.0
    )
    interval: float | None = setting(
        WithUnit("time", positive=True), "time from point to point; without it no times are written", default=None
    )
    warming: float = setting(
        WithUnit("temperature difference"), "warming of the air from the first point to the last", default=0.0
    )


@dataclass(frozen=True)
class Correction:
    """What a corrected probing point scatters by, besides its reflector's place."""

    repeatability: float = setting(
        WithUnit("length", minimum=0.0), "standard deviation of each coordinate at the mover's return", default=0.0
    )
    tip: float = setting(
        WithUnit("length", minimum=0.0), "standard deviation of each coordinate of a probed point", default=0.0
    )


@dataclass(frozen=True)
class Settings:
    """Find reflector positions from lengths, with the tracers' places, dead paths and scales (multilateration)."""

    inputs: Any = setting(Section(Inputs), "the files of the job")
    noise: LengthNoise = setting(Section(LengthNoise), "standard deviation of a length")
    measures: str = setting(
        Choice("changes", "absolute"), "interferometer (dead paths unknown) or absolute distance", default="changes"
    )
    scale: Scale | None = setting(Section(Scale), "estimate the tracers' scales; fixed at 1 without it", default=None)
    environment: Environment | None = setting(
        Section(Environment),
        "the air, and the one that the tracers assume; readings stay as they are without it",
        default=None,
    )
    part: Part | None = setting(
        Section(Part), "temperature and expansion of the part; its points are given at 20 degC", default=None
    )
    datum: str | None = setting(
        Choice("inner-constraints", "points"),
        "what fixes the frame; chosen by the points' sigma unless given",
        default=None,
    )
    outliers: str = setting(
        Choice("report", "remove"), "report outliers only, or also leave them out", default="report"
    )
    tolerance: float = setting(
        WithUnit("length", positive=True), "largest distance of a probing point from its replayed point", default=1.0
    )
    correction: Correction = setting(
        Section(Correction),
        "standard deviations of probed points, for the uncertainty of /corrected",
        default=Correction(),
    )
    features: dict[str, LocatedValue] = features_through("the corrected points")
    simulation: LengthSimulation | None = setting(
        Section(LengthSimulation), "the truth for `metrocli simulate`", default=None
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a fault for each setting of probed points where none are given."""
        for key in ("tolerance", "correction"):
            if self.inputs.probing is None and getattr(self, key) != getattr(Settings, key):
                yield key, "this is of probed points: give `inputs: {probing: probing.csv}`, or leave it out"


_STATISTICS = (
    "rejected", "critical_w", "weakness", "noise_factor", "repeatability", "repeatability_std", *FIGURES,
)  # fmt: skip


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures: estimates of each tracer, the scale of the air, and statistics."""
    tracer = {f"{{tracer}}.{name}": "mm" for name in ("x", "y", "z", "dead_path")} | {"{tracer}.scale": "1"}
    return adjusted(tracer | {"air.scale": "1"}, _STATISTICS, ["mm"])
