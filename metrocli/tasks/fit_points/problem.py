"""The adjustment of a best fit: `X = s R x + d`, with the errors of both lists (generalised least squares).

Measured points x are unknowns that their list observes, where it gives them a standard uncertainty. A coordinate of X
is one reading, or, where X is an unknown place, a reading of zero of `s R x + d - X`. Chi-square is then that of the
errors of both lists. Several stations have a transformation each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field

import numpy as np

from metrocli.adjust.model.blocks import Block, Space
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array, Index, Mask
from metrocli.effects.model import Model, Place
from metrocli.errors import InputError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments.frames import FromFrame, PointOf
from metrocli.table import Table
from metrocli.tasks.fit_points.effects import SCALE
from metrocli.tasks.fit_points.links import PLACE, Coordinate, FromPlace, Scaled
from metrocli.tasks.fit_points.listed import Spread, listed_points
from metrocli.tasks.fit_points.settings import ESTIMATED, Files, Settings
from metrocli.tasks.shared.lists import refuse
from metrocli.tasks.shared.rounding import rounding_of
from metrocli.words import counted, listed, nearest

POINT, POSE = "point", "pose"
AXES, PAIRS = ("x", "y", "z"), ("xy", "xz", "yz")
_FEWEST, _ASKED = 3, 20
"""Points of a best fit, and names that are compared with those of the other list"""
_REACH = 10.0
"""Reach of the transformation, in extents and rad: points may deviate by as much as their distances"""


@dataclass(frozen=True)
class Places:
    """Places in the nominal frame that are unknowns: those of points of several stations, or with covariances."""

    names: tuple[str, ...]
    values: Array
    """(m, 3) as listed, or to start from"""
    free: Mask
    """(m, 3)"""
    of: Index
    """Place of each measured point, (n,)"""
    spread: Spread
    """Of the listed ones"""


@dataclass(frozen=True)
class PointPairs:
    """Measured points with their nominal places, and how well both are known."""

    names: tuple[str, ...]
    measured: Array
    """(n, 3)"""
    nominal: Array
    """(n, 3), nan for a coordinate that is not used"""
    spread: Spread
    """Of the measured points"""
    nominal_sigma: Array
    """0 is exact, nan is unknown"""
    scale: bool
    noise: float | str
    list: Table
    """The list of measured points, also those that the nominal list lacks"""
    list_spread: Spread
    warnings: tuple[str, ...] = ()
    places: Places | None = None
    stations: tuple[str, ...] = ("",)
    station: Index = field(default_factory=lambda: np.zeros(1, dtype=np.intp))
    """Of each measured point, (n,)"""
    fixed: bool = False
    """Whether the first station is the frame"""
    start: tuple[Array, Array] = field(default_factory=lambda: (np.zeros((1, 6)), np.ones(1)))
    """Pose and scale of each station, (stations, 6) and (stations,)"""
    found: float = 0.0
    """The noise that the residuals of a round before showed [mm]; 0 in the first"""

    @property
    def full(self) -> Index:
        """Rows of the points all of whose nominal coordinates are used."""
        return np.flatnonzero(np.isfinite(self.nominal).all(axis=1))

    @property
    def keys(self) -> dict[str, tuple[str, ...]]:
        """What names each measured point: its station, where there are several, and its name."""
        points = {"point": self.names}
        return points if self.joins is None else {"station": tuple(self.stations[i] for i in self.station), **points}

    @property
    def keys_with_places(self) -> dict[str, tuple[str, ...]]:
        """What names each measured point, then each place that is an unknown: its station is "nominal"."""
        places = () if self.places is None else self.places.names
        return {
            key: (*names, *(places if key == "point" else ("nominal",) * len(places)))
            for key, names in self.keys.items()
        }

    @property
    def joins(self) -> Places | None:
        """The places that join several stations; None where there is one."""
        return self.places if self.stations != ("",) else None

    def model(self) -> Model:
        """Return the model at its start, to which effects can be added."""
        blocks = self._blocks(*self.start)
        groups = self._groups(blocks)
        places = {"point": Place(self.names, POINT), "axis": Place(AXES), "pair": Place(PAIRS)}
        measured = tuple(group.name for group in groups if group.name in AXES)
        return Model(blocks, groups, measured=measured, places=places)

    @property
    def _own(self) -> Mask:
        """Which measured coordinates are unknowns that their list observes, (n, 3)."""
        return self.spread.sigma > 0

    def _blocks(self, pose: Array, scale: Array) -> dict[str, Block]:
        extent = self.extent
        reach = np.array([_REACH * extent] * 3 + [_REACH] * 3)
        loose = (np.arange(len(self.stations)) > 0) | (not self.fixed)
        names = tuple(" ".join(parts) for parts in zip(*self.keys.values(), strict=True))
        near = np.array(extent / 10)
        of_scale = (loose & self.scale)[:, None], np.array(0.1), Space.FLAT, "station"
        blocks = [
            Block(POINT, self.measured, AXES, names, self._own, near, noun="point"),
            Block(POSE, pose, poses.COLUMNS, self.stations, loose[:, None], reach, Space.POSE, "station"),
            Block(SCALE, (scale - 1.0)[:, None], ("scale",), self.stations, *of_scale),
        ]
        if self.places is not None:
            known = self.places
            blocks.append(Block(PLACE, known.values, AXES, known.names, known.free, near, noun="place"))
        return {block.name: block for block in blocks}

    def _groups(self, blocks: dict[str, Block]) -> tuple[Group, ...]:
        """Return a group of readings for each axis, and what the lists observe."""
        known = [*self.spread.shared_out[0].observing(blocks[POINT])]
        if self.places is not None:
            listed_places = self.places.spread
            known += (listed_places if self.joins else listed_places.shared_out[0]).observing(blocks[PLACE])
        return (*(group for axis in range(3) if (group := self._along(axis)) is not None), *known)

    def _along(self, axis: int) -> Group | None:
        rows: Index = np.flatnonzero(np.isfinite(self.nominal[:, axis]))
        if not rows.size:
            return None
        whole = Quantity.POINT_IN_MACHINE
        links = (PointOf(POINT, Quantity.POINT_IN_PART), Scaled(), FromFrame(POSE, Quantity.POINT_IN_PART, whole))
        index = {POINT: rows, POSE: self.station[rows], SCALE: self.station[rows]}
        away, readings = list[FromPlace](), self.nominal[rows, axis][None]
        if self.places is not None:
            away, readings = [FromPlace()], np.zeros((1, rows.size))
            index[PLACE] = self.places.of[rows]
        return Group(
            AXES[axis],
            Chain((*links, *away, Coordinate(axis))),
            Observations(
                readings,
                self.sigma[rows, axis][None],
                index,
                keys={key: tuple(names[i] for i in rows) for key, names in self.keys.items()},
                components=(AXES[axis],),
                unit="mm",
            ),
        )

    @property
    def extent(self) -> float:
        """Largest extent of the measured points along an axis [mm]."""
        return float(np.ptp(self.measured, axis=0).max()) or 1.0

    @property
    def rows(self) -> Index:
        """Rows of the measured points in their list."""
        place = {name: row for row, name in enumerate(self.list.texts("point"))}
        return np.array([place[name] for name in self.names], dtype=np.intp)

    @property
    def joint(self) -> bool:
        """Whether points of a list have errors in common."""
        return self.spread.joint is not None or (self.places is not None and self.places.spread.joint is not None)

    @property
    def bare(self) -> Mask:
        """Which coordinates have no standard uncertainty in either list, (n, 3)."""
        return np.asarray(~(self.nominal_sigma > 0) & ~self._own & np.isfinite(self.nominal))

    @property
    def estimated(self) -> bool:
        """Whether a noise is estimated: where it is asked for and some coordinate has no standard uncertainty."""
        return self.noise == ESTIMATED and bool(self.bare.any())

    @property
    def weighed(self) -> bool:
        """Whether the size of an estimated noise is also a weight, against the standard uncertainties of the lists."""
        listed_places = self.places is not None and bool((self.places.spread.sigma > 0).any())
        return self.estimated and (bool((self._own | (self.nominal_sigma > 0)).any()) or listed_places)

    @property
    def start_noise(self) -> float:
        """The noise of an adjustment that estimates it, in the first round a thousandth of the extent [mm]."""
        return self.found or 1e-3 * self.extent

    @property
    def rounding(self) -> float:
        """Deviations that the rounding of the coordinates makes [mm]."""
        return rounding_of(self.measured, self.nominal)

    @property
    def sigma(self) -> Array:
        """Standard deviation of each nominal coordinate as a reading, (n, 3)."""
        noise = self.start_noise if self.noise == ESTIMATED else float(self.noise)
        stated = np.where(self.nominal_sigma > 0, self.nominal_sigma, np.where(self._own, 0.0, noise)) ** 2
        if self.places is not None and self.joins is None:  # their list observes them
            free = self.places.free[self.places.of]
            stated = np.where(free, self.places.spread.shared_out[1][self.places.of][:, None], stated)
        # the part of the measured points, in the size that it has after the transformation
        part = (self.spread.shared_out[1] * self.start[1][self.station] ** 2)[:, None]
        return np.asarray(np.sqrt(stated + np.where(self._own, part, 0.0)))


def problem_of(settings: Settings, files: Files) -> PointPairs:
    """Return the points that both lists have.

    Raises InputError for faults of the lists, UndeterminedError if fewer than three points are in both.
    """
    assert files.nominal is not None
    points, spread = listed_points(files.points)
    nominal, of_nominal = listed_points(files.nominal)
    places = {name: i for i, name in enumerate(nominal.texts("point"))}
    names = points.texts("point")
    rows = [i for i, name in enumerate(names) if name in places]
    of = [places[names[i]] for i in rows]
    measured = set(names)
    alone = [name for name in names if name not in places], [name for name in places if name not in measured]
    if len(rows) < _FEWEST:
        raise UndeterminedError(
            f"{counted(len(rows), 'point', 'are')} in both lists ({listed([names[i] for i in rows]) or 'no name is'}): "
            f"a best fit needs three that are not on a line{_spelt(*alone)}",
            0.0,
        )
    chosen, goals = np.array(rows), of_nominal.of(np.array(of))
    exact = (spread.sigma[rows] == 0) & (goals.sigma == 0)
    if exact.any():
        text = "the point is exact in both lists (sigma 0), so nothing can be fitted to it"
        both = np.zeros(len(points), dtype=bool)
        both[np.array(rows)[exact.all(axis=1)]] = True
        refuse(points, {text: both})
    if "feature" in points:  # points of features need no place in the nominal list
        free = {name for name, feature in zip(names, points.texts("feature"), strict=True) if feature}
        alone = [name for name in alone[0] if name not in free], alone[1]
    warnings = tuple(
        f"{counted(len(some), 'point', 'are')} in {where} only and left out: {listed(some)}"
        for some, where in zip(alone, ("the list of measured points", "the nominal list"), strict=True)
        if some
    )
    wanted = np.column_stack([nominal.numbers(axis, float("nan")) for axis in "xyz"])[of]
    if not np.isfinite(wanted).any():
        raise InputError([nominal.fault("no nominal coordinate is given")])
    return PointPairs(
        tuple(names[i] for i in rows),
        points.stacked("xyz")[rows],
        wanted,
        spread.of(chosen),
        goals.sigma,
        settings.scale,
        settings.noise,
        points,
        spread,
        warnings,
        _observed(tuple(names[i] for i in rows), wanted, goals) if goals.correlated else None,
        station=np.zeros(len(rows), dtype=np.intp),
    )


def _observed(names: tuple[str, ...], wanted: Array, spread: Spread) -> Places:
    """Return nominal places as unknowns that their list observes."""
    free = np.isfinite(wanted) & (spread.sigma > 0)
    return Places(names, np.nan_to_num(wanted), free, np.arange(len(names)), spread)


def _spelt(measured: Sequence[str], nominal: Sequence[str]) -> str:
    """Return the question whether names of the two lists that are nearly alike are one point's; empty if none are."""
    pairs = [f"'{name}' and '{meant}'" for name in measured[:_ASKED] if (meant := nearest(name, nominal))]
    return f"; are these one point each: {listed(pairs, 3)}?" if pairs else ""
