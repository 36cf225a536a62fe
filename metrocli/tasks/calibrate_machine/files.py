"""The files of a calibrate-machine job: their columns, and the tables read from them."""

from __future__ import annotations

from metrocli.frozen import dataclass
from metrocli.settings import TableFile
from metrocli.settings.sections import content, inputs_of
from metrocli.table import TEXT, Column, Columns, Table
from metrocli.tasks.shared.environment import WEATHER
from metrocli.tasks.shared.lists import SIGMAS

_PLACE = tuple(Column(name, "length") for name in ("x", "y", "z"))
_TOOL = Column("tool", TEXT, required=False)
_TIME = Column("t", "time", required=False)
_AIR = Column("temp", "temperature", required=False)
_SIDES = tuple(Column(f"from_{axis}", required=False) for axis in "xyz")
POINTS = Columns(
    (
        Column("point", TEXT),
        *_PLACE,
        *(Column(name, "length") for name in ("mx", "my", "mz")),
        _TIME,
        _TOOL,
        *_SIDES,
    ),
    ("point",),
    "commanded points, and where the tracker measured them",
    measured=("mx", "my", "mz"),
    alike=("x", "y", "z"),
)
PATH = Columns((*_PLACE, _TOOL, Column("feed", "speed", required=False)), (), "vertices of the path, in order")
TRACK = Columns(
    (*_PLACE, _TIME, _TOOL),
    (),
    "points of the tracker along the path",
    measured=("x", "y", "z"),
    fewest_copied=50,
)
LINES = Columns(
    (
        Column("line", TEXT),
        Column("axis", TEXT),
        Column("position", "length"),
        *(Column(name, "length") for name in ("ex", "ey", "ez")),
        *(Column(name, "angle") for name in ("ea", "eb", "ec")),
        *(Column(name, "length", required=False) for name in ("x", "y", "z")),
        _TIME,
        _AIR,
    ),
    (),
    "lines of a laser with six degrees of freedom",
    measured=("ex", "ey", "ez", "ea", "eb", "ec"),
    alike=("axis", "position"),
    group=("line",),
)

LENGTHS = Columns(
    (
        Column("point", TEXT),
        Column("station", TEXT),
        *_PLACE,
        Column("length", "length"),
        _TOOL,
        _TIME,
        _AIR,
        *WEATHER,
        *_SIDES,
    ),
    (),
    "commanded points, and the lengths read there by tracking interferometers",
    measured=("length",),
    alike=("station",),
)
STATIONS = Columns(
    (Column("station", TEXT), *_PLACE, Column("dead_path", "length", required=False, may_be_empty=True), *SIGMAS),
    ("station",),
    "approximate places of the stations",
)


@dataclass(frozen=True)
class Files:
    """The files of a job: which of them are needed depends on the method."""

    points: Table | None = content(TableFile(POINTS), "standstill: commanded and measured points", needed=False)
    path: Table | None = content(TableFile(PATH), "on-the-fly: vertices of the path", needed=False)
    track: Table | None = content(TableFile(TRACK), "on-the-fly: points of the tracker", needed=False)
    lines: Table | None = content(TableFile(LINES), "six-dof: lines along axes and diagonals", needed=False)
    lengths: Table | None = content(TableFile(LENGTHS), "lengths: commanded points and lengths", needed=False)
    stations: Table | None = content(TableFile(STATIONS), "lengths: approximate places of the stations", needed=False)


Inputs = inputs_of(Files)
