"""The files of a calibrate-machine job: their columns, and the tables read from them."""

from __future__ import annotations

import numpy as np

from metrocli.frozen import dataclass
from metrocli.result import Result
from metrocli.settings import Either, FileOf, TableFile
from metrocli.settings.sections import content, inputs_of
from metrocli.table import Columns, Table, columns
from metrocli.tasks.shared.environment import WEATHER
from metrocli.tasks.shared.lists import SIGMAS, listed_places

AXES = ("x? y? z? [length]", "a? b? c? [angle]")
"""Commanded positions; the chain of the machine decides which of them a file needs"""
_SIDES = "from_x? from_y? from_z? from_a? from_b? from_c?"
POINTS = Columns(
    columns(
        "point [text]",
        "run? [text]",
        *AXES,
        "mx? my? mz? distance? [length]",
        "azimuth? elevation? [angle]",
        "t? [time]",
        "tool? [text]",
        "face? [number]",
        _SIDES,
    ),
    ("point", "face"),
    "commanded points, and where the tracker measured them",
    measured=("mx", "my", "mz"),
    alike=("x", "y", "z"),
)
PATH = Columns(columns("x y z [length]", "tool? [text]", "feed? [speed]"), (), "vertices of the path, in order")
TRACK = Columns(
    columns("x y z [length]", "t? [time]", "tool? [text]"),
    (),
    "points of the tracker along the path",
    measured=("x", "y", "z"),
    fewest_copied=50,
)
LINES = Columns(
    columns(
        "line axis [text]",
        "position? [length]",
        "ex?* ey?* ez?* [length]",
        "ea?* eb?* ec?* [angle]",
        *AXES,
        "t? [time]",
        "temp? [temperature]",
    ),
    (),
    "lines of a laser with six degrees of freedom, or what is read of the positioning of single axes alone",
    measured=("ex", "ey", "ez", "ea", "eb", "ec"),
    alike=("axis", "position", "a", "b", "c"),
    group=("line",),
)

LENGTHS = Columns(
    (
        *columns("point station [text]", *AXES, "length? [length]", "tool? [text]", "t? [time]", "temp? [temperature]"),
        *WEATHER,
        *columns(_SIDES),
    ),
    (),
    "commanded points, and the lengths read there by tracking interferometers",
    measured=("length",),
    alike=("station",),
)
STATIONS = Columns(
    (*columns("station [text]", "x y z [length]", "dead_path?* [length]"), *SIGMAS),
    ("station",),
    "approximate places of the stations",
)
PROBING = Columns(
    columns("ball [text]", *AXES, "dx? dy? dz? [length]", "tool? [text]", "t? [time]", "temp? [temperature]", _SIDES),
    (),
    "commanded poses, and the displacement of a ball against the probe there",
    measured=("x", "y", "z", "dx", "dy", "dz"),
    alike=("ball",),
)
BALLS = Columns((*columns("ball [text]", "x y z [length]"), *SIGMAS), ("ball",), "approximate places of the balls")
REFLECTORS = Columns(
    (*columns("reflector on [text]", "x y z [length]"), *SIGMAS),
    ("reflector",),
    "approximate places of reflectors, on the workpiece or at the tool",
)
DISTANCES = Columns(
    columns("from to [text]", "length sigma [length]"), ("from", "to"), "calibrated distances of balls or reflectors"
)
PATHS = Columns(
    columns("path [text]", *AXES, "tool? [text]"), (), "positions of kinematic tests, in the order of travel"
)


@dataclass(frozen=True)
class Files:
    """The files of a job: which of them are needed depends on the method."""

    points: Table | None = content(TableFile(POINTS), "standstill: commanded and measured points", needed=False)
    path: Table | None = content(TableFile(PATH), "on-the-fly: vertices of the path", needed=False)
    track: Table | None = content(TableFile(TRACK), "on-the-fly: points of the tracker", needed=False)
    lines: Table | None = content(TableFile(LINES), "six-dof: lines along axes and diagonals", needed=False)
    lengths: Table | None = content(TableFile(LENGTHS), "lengths: commanded points and lengths", needed=False)
    stations: Table | Result | None = content(
        Either(TableFile(STATIONS), FileOf(("adjust-network",))),
        "lengths: approximate places of the stations, or the network that measured them",
        needed=False,
    )
    probing: Table | None = content(TableFile(PROBING), "probing: poses, and what the probe found", needed=False)
    balls: Table | None = content(TableFile(BALLS), "probing: approximate places of the balls", needed=False)
    distances: Table | None = content(TableFile(DISTANCES), "calibrated distances of balls", needed=False)
    paths: Table | None = content(
        TableFile(PATHS), "paths of kinematic tests, whose errors are predicted", needed=False
    )
    machine: Result | None = content(
        FileOf(("calibrate-machine",)), "an earlier result of the machine, for what is not estimated", needed=False
    )
    reflectors: Table | None = content(TableFile(REFLECTORS), "reflectors, on workpiece or tool", needed=False)
    network: Result | None = content(
        FileOf(("adjust-network",)), "standstill: the network that measured the points", needed=False
    )

    @property
    def poses(self) -> Table | None:
        """The table of a method that reads rotary axes in any pose: points, lengths or probing."""
        return next((table for table in (self.points, self.lengths, self.probing) if table is not None), None)

    @property
    def listed_stations(self) -> Table | None:
        """The list of stations; of a network, its points and stations that have the names of those of the lengths."""
        if not isinstance(self.stations, Result):
            return self.stations
        tables = [(self.stations.tables[name], key) for name, key in (("points", "point"), ("stations", "station"))]
        names = [name for table, key in tables for name in table.texts(key)]
        places = np.concatenate([table.stacked("xyz") for table, _ in tables])
        wanted = set(names if self.lengths is None else self.lengths.texts("station"))
        kept = [row for row, name in enumerate(names) if name in wanted and np.isfinite(places[row]).all()]
        return listed_places("station", [names[row] for row in kept], places[kept])


Inputs = inputs_of(Files)
NO_FILES = Files()
