"""The adjustment of a best fit: `X = s R x + d`, with the errors of both lists (generalised least squares).

Measured points x are unknowns that their list observes, where it gives them a standard uncertainty. A coordinate of X
is one reading. Chi-square is then that of the errors of both lists.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Block, Space
from metrocli.adjust.model.chain import Chain, LinkContext, Step
from metrocli.adjust.model.groups import Group, priors
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array, Index
from metrocli.effects.model import Model, Place
from metrocli.errors import InputError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments.frames import OutOf, PointOf
from metrocli.table import Table
from metrocli.tasks.fit_points.effects import SCALE
from metrocli.tasks.fit_points.settings import ESTIMATED, Files, Settings
from metrocli.tasks.shared.lists import refuse, sigmas
from metrocli.tasks.shared.rounding import rounding_of
from metrocli.words import listed, nearest

POINT, POSE = "point", "pose"
AXES, PAIRS = ("x", "y", "z"), ("xy", "xz", "yz")
_EXACT = 1e-5
"""Standard uncertainty of an exact coordinate, relative to that of the points laid onto it"""
_FEWEST, _ASKED = 3, 20
"""Points of a best fit, and names that are compared with those of the other list"""
_REACH = 10.0
"""Reach of the transformation, in extents and rad: points may deviate by as much as their distances"""


@dataclass(frozen=True)
class Scaled:
    """Link from a point to `(1 + s) x`, s the only member of the block of scales."""

    takes = gives = Quantity.POINT_IN_PART
    blocks = (SCALE,)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return `(1 + s) x` (3, n), with its derivatives by the point and by the scale."""
        scale = 1.0 + float(local.members(SCALE)[0, 0])
        return Step(scale * value, scale * np.eye(3)[:, :, None], {SCALE: value[:, None, :]})


@dataclass(frozen=True)
class Coordinate:
    """Link to one coordinate of a point."""

    axis: int
    takes = Quantity.POINT_IN_MACHINE
    gives = Quantity.LENGTH
    blocks = ()

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the coordinate, (1, n), with its derivative."""
        return Step(value[self.axis][None], np.eye(3)[self.axis][None, :, None])


@dataclass(frozen=True)
class PointPairs:
    """Points that both lists have, with their standard deviations, nan where there are none."""

    names: tuple[str, ...]
    measured: Array
    """(n, 3)"""
    nominal: Array
    """(n, 3), nan for a coordinate that is not used"""
    measured_sigma: Array
    nominal_sigma: Array
    """0 is exact"""
    scale: bool
    noise: float | str
    list: Table
    """The list of measured points, also those that the nominal list lacks"""
    warnings: tuple[str, ...] = ()

    @property
    def full(self) -> Index:
        """Rows of the points all of whose nominal coordinates are used."""
        return np.flatnonzero(np.isfinite(self.nominal).all(axis=1))

    def model(self, pose: Array, scale: float) -> Model:
        """Return the model at starting values, to which effects can be added."""
        blocks = self._blocks(pose, scale)
        groups = self._groups(blocks)
        places = {"point": Place(self.names, POINT), "axis": Place(AXES), "pair": Place(PAIRS)}
        measured = tuple(group.name for group in groups if group.name in AXES)
        return Model(blocks, groups, measured=measured, places=places)

    def _blocks(self, pose: Array, scale: float) -> dict[str, Block]:
        extent = float(np.ptp(self.measured, axis=0).max()) or 1.0
        reach = np.array([_REACH * extent] * 3 + [_REACH] * 3)
        free = np.isfinite(self.measured_sigma) & (self.measured_sigma > 0)
        blocks = (
            Block(POINT, self.measured, ("x", "y", "z"), self.names, free, np.array(extent / 10), noun="point"),
            Block(POSE, pose[None], poses.COLUMNS, reach=reach, space=Space.POSE),
            Block(SCALE, np.array([[scale - 1.0]]), ("scale",), free=np.array(self.scale), reach=np.array(0.1)),
        )
        return {block.name: block for block in blocks}

    def _groups(self, blocks: dict[str, Block]) -> tuple[Group, ...]:
        """Return a group of readings for each axis, and what the list of measured points observes."""
        return (*(group for axis in range(3) if (group := self._along(axis)) is not None), *self._known(blocks[POINT]))

    def _along(self, axis: int) -> Group | None:
        rows: Index = np.flatnonzero(np.isfinite(self.nominal[:, axis]))
        if not rows.size:
            return None
        whole = Quantity.POINT_IN_MACHINE
        links = (PointOf(POINT, Quantity.POINT_IN_PART), Scaled(), OutOf(POSE, Quantity.POINT_IN_PART, whole))
        zero = np.zeros(rows.size, dtype=np.intp)
        return Group(
            "xyz"[axis],
            Chain((*links, Coordinate(axis))),
            Observations(
                self.nominal[rows, axis][None],
                self.sigma[rows, axis][None],
                {POINT: rows, POSE: zero, SCALE: zero},
                keys={"point": tuple(self.names[i] for i in rows)},
                components=("xyz"[axis],),
                unit="mm",
            ),
        )

    @property
    def estimated(self) -> bool:
        """Whether a noise is estimated: where it is asked for and some coordinate has no standard uncertainty."""
        bare = np.isnan(self.nominal_sigma) & ~(self.measured_sigma > 0) & np.isfinite(self.nominal)
        return self.noise == ESTIMATED and bool(bare.any())

    @property
    def start_noise(self) -> float:
        """A noise to begin with where it is estimated: a thousandth of the extent [mm]."""
        return 1e-3 * (float(np.ptp(self.measured, axis=0).max()) or 1.0)

    @property
    def rounding(self) -> float:
        """Deviations that the rounding of the coordinates makes [mm]."""
        return rounding_of(self.measured, self.nominal)

    @property
    def sigma(self) -> Array:
        """Standard deviation of each nominal coordinate as a reading, (n, 3)."""
        free = np.isfinite(self.measured_sigma) & (self.measured_sigma > 0)
        noise = self.start_noise if self.noise == ESTIMATED else float(self.noise)
        stated = np.where(np.isfinite(self.nominal_sigma), self.nominal_sigma, np.where(free, 0.0, noise))
        least = _EXACT * np.where(free, self.measured_sigma, noise)
        return np.maximum(stated, least)

    def _known(self, block: Block) -> tuple[Group, ...]:
        return tuple(priors(block, self.measured_sigma, block.free))


def problem_of(settings: Settings, files: Files) -> PointPairs:
    """Return the points that both lists have.

    Raises InputError for faults of the lists, UndeterminedError if fewer than three points are in both.
    """
    points, nominal = files.points, files.nominal
    assert nominal is not None
    places = {name: i for i, name in enumerate(nominal.texts("point"))}
    names = points.texts("point")
    rows = [i for i, name in enumerate(names) if name in places]
    of = [places[names[i]] for i in rows]
    alone = [name for name in names if name not in places], [name for name in places if name not in set(names)]
    if len(rows) < _FEWEST:
        raise UndeterminedError(
            f"{len(rows)} points are in both lists ({listed([names[i] for i in rows]) or 'no name is'}): a best fit "
            f"needs three that are not on a line{_spelt(*alone)}",
            0.0,
        )
    sigma, of_nominal = sigmas(points), sigmas(nominal)
    exact = (sigma[rows] == 0) & (of_nominal[of] == 0)
    if exact.any():
        text = "the point is exact in both lists (sigma 0), so nothing can be fitted to it"
        both = np.zeros(len(points), dtype=bool)
        both[np.array(rows)[exact.all(axis=1)]] = True
        refuse(points, {text: both})
    if "feature" in points:  # points of features need no place in the nominal list
        free = {name for name, feature in zip(names, points.texts("feature"), strict=True) if feature}
        alone = [name for name in alone[0] if name not in free], alone[1]
    warnings = tuple(
        f"{len(some)} points are in {where} only and are left out: {listed(some)}"
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
        np.where(sigma == 0, np.nan, sigma)[rows],
        of_nominal[of],
        settings.scale,
        settings.noise,
        points,
        warnings,
    )


def _spelt(measured: Sequence[str], nominal: Sequence[str]) -> str:
    """Return the question whether names of the two lists that are nearly alike are one point's; empty if none are."""
    pairs = [f"'{name}' and '{meant}'" for name in measured[:_ASKED] if (meant := nearest(name, nominal))]
    return f"; are these one point each: {listed(pairs, 3)}?" if pairs else ""
