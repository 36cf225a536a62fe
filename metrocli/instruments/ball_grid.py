"""An uncalibrated grid of balls, measured in several views by an uncalibrated machine.

`reading = G(site) + d + R(w) (Rot (pitch b + A(b)) + pitch shift)`, with site = Rot b + shift. G is the error of the
machine at a site, A that of the artefact at a ball b. Rot and shift are the nominal mounting of the view, d and w its
deviation from it (Dang, Lee and Kim, eq. 1-5, with exact rotations instead of a small misalignment E).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from metrocli.adjust.coupled_fields import Fields
from metrocli.adjust.model.blocks import Block, Space
from metrocli.adjust.model.chain import Chain, LinkContext, Step
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.geometry.rotations import cross_matrix
from metrocli.instruments.frames import FromFrame

MACHINE, ARTEFACT, VIEW = "machine_error", "artefact_error", "view"
"""Blocks: machine error G at each site, artefact error A at each ball, mounting deviation d, w of each view"""
COLUMNS = ("ex", "ey", "ez")
HOLLOW = "hollow"
"""Condition of a reading [mm^2]: `rho^2 - mean rho^2` of its view; rho: horizontal distance from the centre"""


@dataclass(frozen=True)
class View:
    """A nominal mounting: a ball b of the artefact stands at the site `turn b + shift`, in pitches."""

    name: str
    turn: Array
    """(3, 3) of whole numbers, a rotation by multiples of 90 degrees"""
    shift: Array
    """(3,) whole numbers"""

    def sites(self, balls: Index) -> Index:
        """Return the sites of balls (n, 3) in this view."""
        return np.asarray(np.rint(balls @ self.turn.T + self.shift), dtype=np.intp)


@dataclass(frozen=True)
class BallOf:
    """Start of a chain: a ball in the artefact, its nominal place plus its error."""

    nominal: Array
    """(balls, 3) [mm]"""
    takes = None
    gives = Quantity.BALL_IN_ARTEFACT
    blocks = (ARTEFACT,)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return `pitch b + A` (3, n) and its derivative by A."""
        ball = self.nominal.T[:, local.index(ARTEFACT)] + local.rows(ARTEFACT)
        return Step(ball, by_block={ARTEFACT: np.eye(3)[:, :, None]} if ARTEFACT in local.wanted else {})


@dataclass(frozen=True)
class Mounted:
    """Link from the artefact to the nominal mounting of the view: `Rot x + pitch shift`."""

    turns: Array
    """(views, 3, 3)"""
    shifts: Array
    """(views, 3) [mm]"""
    takes = Quantity.BALL_IN_ARTEFACT
    gives = Quantity.BALL_ON_TABLE
    blocks = ()

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the mounted ball, (3, n), and its derivative by the ball in the artefact."""
        view = local.index(VIEW)
        turn = np.ascontiguousarray(np.moveaxis(self.turns, 0, -1)[:, :, view])
        return Step(np.einsum("abn,bn->an", turn, value) + self.shifts.T[:, view], turn)


@dataclass(frozen=True)
class WithMachineError:
    """Link to the reading of the machine: the place of the ball plus the machine error at its nominal site."""

    takes = Quantity.POINT_IN_MACHINE
    gives = Quantity.MACHINE_READING
    blocks = (MACHINE,)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return `x + G(site)`, (3, n), with derivatives of 1 by both."""
        identity = np.eye(3)[:, :, None]
        return Step(value + local.rows(MACHINE), identity, {MACHINE: identity} if MACHINE in local.wanted else {})


@dataclass(frozen=True)
class BallDistance:
    """Start of a chain: the distance of two balls of the artefact."""

    nominal: Array
    """(balls, 3) [mm]"""
    takes = None
    gives = Quantity.LENGTH
    blocks = (ARTEFACT,)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the distance (1, n) with its derivatives by both balls, (2, 1, 3, n)."""
        balls = self.nominal + local.members(ARTEFACT)
        first, second = local.index(ARTEFACT)
        between = (balls[first] - balls[second]).T
        distance = np.sqrt((between**2).sum(axis=0))
        towards = (between / distance)[None]
        return Step(distance[None], by_block={ARTEFACT: np.stack([towards, -towards])})


def mounted(views: Sequence[View], pitch: float) -> Mounted:
    """Return the link of the nominal mountings."""
    return Mounted(np.stack([view.turn for view in views]), np.stack([view.shift for view in views]) * pitch)


def chain(views: Sequence[View], balls: Index, pitch: float) -> Chain:
    """Return the forward model of a reading; `balls` (n, 3) are the members of the artefact's block."""
    return Chain(
        (
            BallOf(np.asarray(balls * pitch, dtype=float)),
            mounted(views, pitch),
            FromFrame(VIEW, Quantity.BALL_ON_TABLE, Quantity.POINT_IN_MACHINE),
            WithMachineError(),
        )
    )


def field_block(name: str, indices: Index, noun: str) -> Block:
    """Return the block of an error field, zero at all sites or balls (n, 3)."""
    members = tuple(" ".join(map(str, row)) for row in indices.tolist())
    return Block(name, np.zeros((len(indices), 3)), COLUMNS, members, noun=noun)


def view_block(views: Sequence[View], values: Array) -> Block:
    """Return the block of the mounting deviations of the views, (views, 6), as poses."""
    names = tuple(view.name for view in views)
    return Block(VIEW, values, poses.COLUMNS, names, space=Space.POSE, noun="view")


def hollow(views: Sequence[View], view: Index, balls: Index, pitch: float) -> Array:
    """Return the condition `HOLLOW` of readings (n,) of balls (n, 3)."""
    offsets = np.empty(len(balls))
    for n, measured in enumerate(views):
        rows = view == n
        square: Array = ((balls[rows] @ measured.turn.T)[:, :2] ** 2).sum(axis=1) * pitch**2
        offsets[rows] = square - (square.mean() if square.size else 0.0)
    return offsets


def numbers_at(known: Index, wanted: Index) -> Index:
    """Return the number of each wanted site or ball (..., 3) in the list of known ones (n, 3); -1 if it is absent."""
    low = known.min(axis=0)
    # a table over the whole box: one look-up for each site instead of a search
    box = np.full(known.max(axis=0) - low + 1, -1, dtype=np.intp)
    box[tuple((known - low).T)] = np.arange(len(known))
    place = wanted - low
    inside = ((place >= 0) & (place < box.shape)).all(axis=-1)
    # places outside are looked up at the lowest corner and dropped
    return np.where(inside, box[tuple(np.moveaxis(np.where(inside[..., None], place, 0), -1, 0))], -1)


@dataclass(frozen=True)
class Grid:
    """The measured sites and balls, as indices in units of the pitch."""

    sites: Index
    """(sites, 3)"""
    balls: Index
    """(balls, 3)"""
    pitch: float
    half: Index
    """Largest index of the grid in each direction, (3,)"""

    @property
    def site_places(self) -> Array:
        """Places of the sites, (sites, 3) [mm]."""
        return np.asarray(self.sites * self.pitch, dtype=float)

    @property
    def ball_places(self) -> Array:
        """Nominal places of the balls in the artefact, (balls, 3) [mm]."""
        return np.asarray(self.balls * self.pitch, dtype=float)

    @property
    def within(self) -> Array:
        """1 for sites within the grid, 0 for sites outside that only shifted views reach, (sites,)."""
        return np.asarray((np.abs(self.sites) <= self.half).all(axis=1), dtype=float)


def fields(grid: Grid, blocks: Mapping[str, Block], groups: Sequence[Group], scale_given: bool) -> Fields:
    """Return the adjustment with its datum: G and A contain no rigid motion.

    Without a calibrated length, `sum G.r = sum A.r` fixes the scale.
    """
    return Fields(blocks, tuple(groups), MACHINE, ARTEFACT, folded(grid.sites), _at_rest, datum(grid, scale_given))


def _at_rest(blocks: Mapping[str, Block]) -> dict[str, Block]:
    """Return the blocks at the design point: nominal mountings and zero errors; effects keep their values."""
    return {
        name: block.with_values(np.zeros_like(block.values)) if name in (MACHINE, ARTEFACT, VIEW) else block
        for name, block in blocks.items()
    }


@dataclass(frozen=True)
class FieldSums:
    """Start of a chain: weighted sums over machine error and artefact error, the conditions of the datum."""

    machine: Array
    """(conditions, sites, 3)"""
    artefact: Array
    """(conditions, balls, 3)"""
    takes = None
    gives = Quantity.PARAMETERS
    blocks = (MACHINE, ARTEFACT)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the sums, (1, conditions), and their derivatives by all members, (members, 1, 3, conditions)."""
        machine, artefact = local.members(MACHINE), local.members(ARTEFACT)
        sums = np.einsum("cna,na->c", self.machine, machine) + np.einsum("cna,na->c", self.artefact, artefact)
        by_block = {
            name: np.ascontiguousarray(np.moveaxis(rows, 0, -1))[:, None]
            for name, rows in ((MACHINE, self.machine), (ARTEFACT, self.artefact))
        }
        return Step(sums[None], by_block=by_block)


def as_readings(conditions: Mapping[str, Array], sigma: float) -> Group:
    """Return the conditions of the datum as readings of zero, for adjustments whose datum cannot span two blocks."""
    # rows of length 1, so that one sigma holds shifts, turns and scale alike
    length = np.sqrt(sum((rows**2).sum(axis=(1, 2)) for rows in conditions.values()))[:, None, None]
    machine, artefact = (conditions[name] / length for name in (MACHINE, ARTEFACT))
    count = len(machine)
    index = {
        name: np.repeat(np.arange(rows.shape[1])[:, None], count, axis=1)
        for name, rows in ((MACHINE, machine), (ARTEFACT, artefact))
    }
    observations = Observations(np.zeros((1, count)), np.array(sigma), index, components=("condition",), unit="mm")
    return Group("datum", Chain((FieldSums(machine, artefact),)), observations)


def datum(grid: Grid, scale_given: bool) -> dict[str, Array]:
    """Return the coefficients of the datum conditions for G and A, each (12 or 13, members, 3).

    Six conditions remove the rigid motions of G, six those of A; a thirteenth fixes the scale without a given length.
    """
    # sites that only shifted views reach would move the datum whenever a view is added
    weights = grid.within[:, None, None]
    sites, balls = grid.site_places, grid.ball_places
    machine, artefact = rigid(sites) * weights, rigid(balls)
    none_g, none_a = np.zeros((*machine.shape[:2], 6)), np.zeros((*artefact.shape[:2], 6))
    rows = {
        MACHINE: [machine, none_g, *([] if scale_given else [sites[:, :, None] * weights])],
        ARTEFACT: [none_a, artefact, *([] if scale_given else [-balls[:, :, None]])],
    }
    return {name: np.moveaxis(np.concatenate(parts, axis=2), 2, 0) for name, parts in rows.items()}


def rigid(places: Array) -> Array:
    """Return the six rigid motions of places (n, 3) [mm], (n, 3, 6): shifts, then rotations."""
    motions = np.zeros((len(places), 3, 6))
    motions[:, :, :3] = np.eye(3)
    motions[:, :, 3:] = -cross_matrix(places)
    return motions


def folded(sites: Index) -> Array:
    """Return for each component of G at each site a place that is the same for all rotations of the cube, (n, 3, 3).

    Rotated views couple a component at a site with its images under the rotations. All images have the same distance
    from the centre along the axis of the component, and the same two distances across it. These three are the place.
    """
    distance = np.abs(sites).astype(float)
    places = np.empty((len(sites), 3, 3))
    for axis in range(3):
        across = np.sort(np.delete(distance, axis, axis=1), axis=1)
        places[:, axis] = np.column_stack([distance[:, axis], across])
    return places
