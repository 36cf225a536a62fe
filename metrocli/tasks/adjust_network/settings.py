"""Settings of an adjust-network job, and the columns of its files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

from metrocli.frozen import dataclass
from metrocli.result import Result
from metrocli.settings import (
    Choice,
    Either,
    FileOf,
    Flag,
    ListOf,
    MapOf,
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
from metrocli.tasks.shared.figures import adjusted
from metrocli.tasks.shared.lists import SIGMAS
from metrocli.tasks.shared.noise import model_setting
from metrocli.words import listed

TRACKER, TOTAL_STATION, INTERFEROMETER = "tracker", "total-station", "interferometer"
GIVEN, INNER = "given", "inner-constraints"
POINT_RESULTS = ("adjust-network", "multilaterate", "calibrate-camera")
"""Kinds whose results are points"""
READINGS = Columns(
    columns(
        "station point [text]",
        "az?* el?* hz?* zd?* [angle]",
        "d?* [length]",
        "face?* [number]",
        "round?* setup?* [text]",
        "th?* [length]",
        "t? [time]",
        "temp? [temperature]",
        "sigma_az?* sigma_el?* sigma_hz?* sigma_zd?* [angle]",
        "sigma_d?* [length]",
    ),
    ("station", "point", "face", "round", "setup", "th", "t"),
    "sightings of trackers and total stations",
    measured=("az", "el", "hz", "zd", "d"),
    alike=("point",),
)
STATIONS = Columns(
    columns(
        "station instrument [text]",
        "over?* [text]",
        "height?* sigma_height?* centring?* [length]",
        "x?* y?* z?* [length]",
        "gamma?* [angle]",
    ),
    ("station",),
    "set-ups of the instruments",
)
LENGTHS = Columns(
    columns("station point [text]", "length [length]", "t? [time]", "temp? [temperature]"),
    ("station", "point", "t"),
    "lengths read by interferometers",
    measured=("length",),
    alike=("station",),
)
BARS = Columns(columns("bar from to [text]", "length sigma [length]"), ("bar",), "calibrated lengths between points")
HEIGHTS = Columns(
    columns("from to [text]", "dh sigma [length]", "t? [time]", "method? [text]"), (), "height differences"
)
SETUPS = Columns(columns("setup [text]", "height [length]", "sigma* [length]"), ("setup",), "set-ups of targets")
POINTS = Columns(
    (*columns("point [text]", "x y z [length]"), *SIGMAS), ("point",), "points of the network, and how they are known"
)
COVARIANCE = Columns(
    columns("point_a axis_a point_b axis_b [text]", "covariance_mm2"),
    ("point_a", "axis_a", "point_b", "axis_b"),
    "covariances between coordinates of given points",
)


@dataclass(frozen=True)
class Files:
    """What the instruments of a network read, their set-ups, and what is known of its points."""

    readings: Table | None = content(TableFile(READINGS), needed=False)
    stations: Table = content(TableFile(STATIONS), default=ABSENT)
    lengths: Table | None = content(TableFile(LENGTHS), needed=False)
    bars: Table | None = content(TableFile(BARS), needed=False)
    heights: Table | None = content(TableFile(HEIGHTS), needed=False)
    setups: Table | None = content(TableFile(SETUPS), needed=False)
    points: Table | Result | None = content(
        Either(TableFile(POINTS), FileOf(POINT_RESULTS)), "points, or the result that measured them", needed=False
    )
    covariance: Table | None = content(TableFile(COVARIANCE), needed=False)

    @property
    def sightings(self) -> Table:
        """The readings of trackers and total stations; empty if there are none."""
        return ABSENT if self.readings is None else self.readings


Inputs = inputs_of(Files)


@dataclass(frozen=True)
class DistanceNoise:
    """Standard deviation of a distance, `sqrt(constant^2 + (proportional d)^2)`."""

    constant: float = setting(WithUnit("length", minimum=0.0), "the part that does not depend on the distance")
    proportional: float = setting(WithUnit("ratio", minimum=0.0), "the part proportional to it", default=0.0)

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for a noise of nothing."""
        if not self.constant and not self.proportional:
            yield "constant", "a distance is not exact: give its standard deviation"


@dataclass(frozen=True, kw_only=True)
class InstrumentNoise:
    """Standard deviations of what an instrument reads."""

    azimuth: float = setting(WithUnit("angle", minimum=0.0), "of the horizontal circle", default=0.0)
    elevation: float = setting(WithUnit("angle", minimum=0.0), "of the vertical circle", default=0.0)
    lateral: float = setting(WithUnit("length", minimum=0.0), "of the point, square to the beam", default=0.0)
    centring: float = setting(WithUnit("length", minimum=0.0), "of the target over its point", default=0.0)
    distance: DistanceNoise | None = setting(Section(DistanceNoise), "of the distance", default=None)


@dataclass(frozen=True, kw_only=True)
class NetworkInstrument:
    """One instrument of the network, which may stand at several stations."""

    type: str = setting(Choice(TRACKER, TOTAL_STATION, INTERFEROMETER), "what kind of instrument it is")
    levelled: bool | None = setting(
        Flag(), "whether its standing axis is vertical; a total station's is unless said otherwise", default=None
    )
    measures: str = setting(
        Choice("changes", "absolute"), "interferometer: changes of length, or absolute distances", default="changes"
    )
    noise: InstrumentNoise | None = setting(
        Section(InstrumentNoise), "standard deviations; or sigma columns of the readings", default=None
    )

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for keys that do not belong to the type."""
        if self.type == INTERFEROMETER and self.levelled is not None:
            yield "levelled", "an interferometer has no standing axis"
        if self.type != INTERFEROMETER and self.measures != "changes":
            yield "measures", f"this is of interferometers; a {self.type} reads distances: leave it out"
        if self.type == INTERFEROMETER and (self.noise is None or self.noise.distance is None):
            yield "noise", "an interferometer needs `noise: {distance: {constant: 0.3 um, proportional: 0.1 um/m}}`"

    @property
    def is_levelled(self) -> bool:
        """Whether its standing axis is vertical."""
        return self.type == TOTAL_STATION if self.levelled is None else self.levelled


@dataclass(frozen=True)
class Vertical:
    """How verticals lean and beams bend over the network."""

    radius: float = setting(WithUnit("radius", positive=True), "radius of the earth")
    refraction: float = setting(
        Number(), "coefficient of refraction k: radius of the earth over that of the beam", default=0.0
    )


@dataclass(frozen=True)
class Region:
    """A box in which stations may stand."""

    low: tuple[float, ...] = setting(ListOf(WithUnit("length"), 3), "its low corner", key="from")
    high: tuple[float, ...] = setting(ListOf(WithUnit("length"), 3), "its high corner", key="to")


@dataclass(frozen=True)
class NetworkPlanning:
    """What `metrocli plan` may add to the network."""

    stations: int = setting(Whole(minimum=1), "number of further stations", default=1)
    region: Region | None = setting(Section(Region), "where they may stand", default=None)
    faces: int = setting(Whole(minimum=1, maximum=2), "faces in which each point is measured", default=1)
    rolled: bool = setting(Flag(), "whether a further station may stand on its side", default=False)
    aim: str = setting(
        Choice("points", "instrument", "pairs"),
        "what is to be known best: the points, the errors of the instrument, or the distances between points",
        default="points",
    )

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield a fault for further stations that may stand nowhere."""
        if self.region is None and (self.stations > 1 or self.rolled or self.aim != "points"):
            example = "`region: {from: [0 mm, 0 mm, 0 mm], to: [8 m, 5 m, 2 m]}`"
            yield "region", f"without it no further station is sought: say where it may stand, {example}"


@dataclass(frozen=True)
class NetworkSimulation:
    """The truth for `metrocli simulate`: points and stations of the files; readings of all points from all stations."""

    faces: int = setting(Whole(minimum=1, maximum=2), "faces in which each point is measured", default=1)
    interval: float | None = setting(
        WithUnit("time", positive=True), "time from one sighting to the next; without it no times", default=None
    )
    point_error: float = setting(
        WithUnit("length", minimum=0.0), "standard deviation of the listed points", default=0.0
    )


@dataclass(frozen=True)
class Settings:
    """Find the points and stations of a network from all that its instruments read, in one adjustment."""

    inputs: Any = setting(Section(Inputs), "the files of the job")
    instruments: dict[str, NetworkInstrument] = setting(MapOf(Section(NetworkInstrument)), "the instruments by name")
    datum: str | None = setting(
        Choice(INNER, GIVEN),
        "what fixes the frame: given points, or inner constraints; given points if they fix every motion",
        default=None,
    )
    datum_points: tuple[str, ...] | None = setting(
        ListOf(Text()),
        "points on whose listed places inner constraints lay the network; all unless given",
        default=None,
    )
    vertical: Vertical | None = setting(
        Section(Vertical), "verticals that lean and beams that bend; parallel and straight without it", default=None
    )
    outliers: str = setting(
        Choice("report", "remove"), "report outliers only, or also leave them out", default="report"
    )
    noise: str = model_setting()
    plan: NetworkPlanning | None = setting(Section(NetworkPlanning), "what `metrocli plan` may add", default=None)
    simulation: NetworkSimulation | None = setting(
        Section(NetworkSimulation), "the truth for `metrocli simulate`", default=None
    )

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield faults for datum points without use or named twice, and for a levelled instrument on its side."""
        if self.datum == GIVEN and self.datum_points is not None:
            yield "datum_points", f"these are of inner constraints: leave them out, or write `datum: {INNER}`"
        twice = [name for name, count in Counter(self.datum_points or ()).items() if count > 1]
        if twice:
            yield "datum_points", f"named more than once: {listed(twice)}; name each point once"
        name = self.of_further_stations
        if self.plan is not None and self.plan.rolled and name is not None and self.instruments[name].is_levelled:
            yield (
                "plan.rolled",
                f"further stations are of {name}, which is levelled and cannot stand on its side: "
                "remove `rolled: true`, or name a tracker first among `instruments`",
            )

    @property
    def of_further_stations(self) -> str | None:
        """The instrument of the stations that a plan adds: the first that is not an interferometer."""
        return next((name for name, kind in self.instruments.items() if kind.type != INTERFEROMETER), None)


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures: estimates of each station, and statistics."""
    lengths = {f"{{station}}.{name}": "mm" for name in ("x", "y", "z", "dead_path", "height")}
    angles = {f"{{station}}.{name}": "rad" for name in ("alpha", "beta", "gamma")}
    rounds = {"{station}.gamma.{round}": "rad", "{setup}.height": "mm"}
    return adjusted(lengths | angles | rounds, ("rejected", "critical_w", "noise_factor"), ["mm", "rad"])
