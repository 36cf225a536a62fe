"""Groups: a chain with its observations, its linearisation at given values, and priors as groups."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block, Space
from metrocli.adjust.model.chain import Chain, LinkContext, Step
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Touch:
    """Derivatives of a group's whitened predictions by one block."""

    block: str
    index: Index
    """Member that each reading uses, (n,), or that each slot of a lattice uses, (m,)"""
    jacobian: Array
    """(d, size, n)"""


def rows_of(touches: Sequence[Touch], shape: tuple[int, int], columns: Mapping[str, Index], width: int) -> Array:
    """Return derivatives as whole rows, (d, n, width), of `shape` (d, n).

    `columns` has the number of each entry of a block, (members, size); -1 if it is fixed. Other blocks are left out.
    """
    # fixed entries have place -1: they fall into a last column that is dropped
    rows, reading = np.zeros((*shape, width + 1)), np.arange(shape[1])[:, None]
    for touch in touches:
        if touch.block in columns:
            places, by_column = columns[touch.block], np.moveaxis(touch.jacobian, 1, 2)
            if len(places) == 1:
                rows[:, :, places[0]] += by_column
            else:
                rows[:, reading, places[touch.index]] += by_column
    return rows[:, :, :-1]


@dataclass(frozen=True)
class LinearGroup:
    """A group linearised: residuals `reading - predicted` and derivatives of the prediction, both whitened."""

    residual: Array
    """(d, n)"""
    touches: tuple[Touch, ...]

    @property
    def cost(self) -> float:
        """Sum of squares of the whitened residuals."""
        return float(np.vdot(self.residual, self.residual))


@dataclass(frozen=True)
class Group:
    """Readings of one kind with the chain that predicts them."""

    name: str
    chain: Chain
    observations: Observations
    weights: Array | None = None
    """Factors (n,) on the weights 1/sigma^2 of the readings, for robust starts; None means 1"""

    def linear(self, blocks: Mapping[str, Block], wanted: frozenset[str]) -> LinearGroup:
        """Return the group linearised at the blocks' values, with derivatives by the wanted blocks."""
        observations = self.observations
        wanted = wanted.intersection(self.chain.blocks)
        steps = self.chain.steps(blocks, observations, wanted)
        residual = self._weighted(observations.whitened(observations.readings - steps[-1].value))
        local = LinkContext(blocks, observations, wanted)
        touches = []
        for name, jacobian in self.chain.derivatives(steps, wanted).items():
            slots = jacobian if jacobian.ndim == 4 else jacobian[None]
            index = np.atleast_2d(local.slots(name))
            # a reading that uses k members of a block (the two ends of a length) touches it k times
            for slot, members in zip(slots, index, strict=True):
                whitened = self._weighted(observations.whitened(slot))
                touches.append(Touch(name, members, np.broadcast_to(whitened, (*slot.shape[:2], observations.count))))
        return LinearGroup(residual, tuple(touches))

    def residuals(self, blocks: Mapping[str, Block]) -> Array:
        """Return `reading - predicted` in the unit of the reading, (d, n)."""
        return self.observations.readings - self.chain.predict(blocks, self.observations)

    def simulated(self, blocks: Mapping[str, Block]) -> Group:
        """Return the group with the readings that the chain predicts, without noise."""
        return self.with_observations(self.observations.with_readings(self.chain.predict(blocks, self.observations)))

    def with_observations(self, observations: Observations) -> Group:
        """Return the group with other observations and without robust weights."""
        return replace(self, observations=observations, weights=None)

    def selected(self, keep: Mask | Index) -> Group:
        """Return the group with some of its readings."""
        return self.with_observations(self.observations.selected(keep))

    def with_noise_times(self, factor: float | Array) -> Group:
        """Return the group with a factor on the standard deviations of its readings, or one of each, (d, n)."""
        observations, each = self.observations, np.asarray(factor)
        both = each[:, None] * each if each.ndim else each**2
        covariance = None if observations.covariance is None else observations.covariance * both
        return self.with_observations(replace(observations, sigma=observations.sigma * factor, covariance=covariance))

    def _weighted(self, values: Array) -> Array:
        # the weight is of 1/sigma^2, so that a residual and its derivatives take its root
        return values if self.weights is None else values * np.sqrt(self.weights)


@dataclass(frozen=True)
class ReadBlock(OfBlock):
    """The forward model of a prior: the values of a block themselves, as if they were measured.

    `value = difference(values, reference)` in the chosen columns, so a reading of zero means "equal to the reference".
    """

    reference: Array
    """(members, size)"""
    columns: tuple[int, ...]
    space: Space = Space.FLAT
    takes = None
    gives = Quantity.PARAMETERS

    def entries(self, index: Index) -> tuple[Index, Index]:
        """Return members and columns of the entries that readings with an index read."""
        members, columns = np.meshgrid(np.unique(index), self.columns, indexing="ij")
        return members.ravel(), columns.ravel()

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the differences (columns, n) and their derivatives by a step of the block."""
        values = local.members(self.block)
        difference = self.space.difference(values, self.reference)[:, self.columns]
        by_step = self.space.difference_by_step(values, self.reference)[:, self.columns, :]
        return Step(local.spread(difference, self.block), by_block={self.block: local.spread(by_step, self.block)})


def prior(
    block: Block,
    members: Index,
    sigma: Array | None = None,
    covariance: Array | None = None,
    columns: tuple[int, ...] | None = None,
) -> Group:
    """Return a prior: the group that holds members of a block to their present values.

    sigma is (len(members), len(columns)); a covariance (len(columns), len(columns)) is for a single member.
    """
    columns = tuple(range(block.size)) if columns is None else columns
    n = len(members)
    observations = Observations(
        readings=np.zeros((len(columns), n)),
        # not used beside a covariance, but the field needs a value
        sigma=np.ones(1) if sigma is None else np.asarray(sigma, dtype=float).T,
        index={block.name: np.asarray(members, dtype=np.intp)},
        covariance=None if covariance is None else np.asarray(covariance, dtype=float)[:, :, None],
        keys={"member": tuple(block.members[i] for i in members)},
        components=tuple(block.columns[i] for i in columns),
    )
    link = ReadBlock(block.name, block.values, columns, block.space)
    return Group(f"prior of {block.name}", Chain((link,)), observations)


def priors(block: Block, sigma: Array, free: Mask) -> list[Group]:
    """Return the priors of a block: one group for each set of columns that has standard deviations.

    sigma (members, size): above zero a prior, nan unknown, 0 exact. free (members, size): what is solved for.
    """
    # an exact entry is not an unknown, and a prior of sigma 0 would divide by it
    known = free & np.isfinite(sigma) & (sigma > 0)
    groups: list[Group] = []
    # readings of a group have the same components, so entries of which some lack a prior are groups of their own
    for pattern in np.unique(known, axis=0) if known.any() else ():
        columns = np.flatnonzero(pattern)
        members = np.flatnonzero((known == pattern).all(axis=1))
        if columns.size and members.size:
            groups.append(prior(block, members, sigma[np.ix_(members, columns)], columns=tuple(columns.tolist())))
    return groups


@dataclass(frozen=True)
class ReadEntries(OfBlock):
    """The forward model of a joint prior: entries of a block, of any members and columns, read as one vector."""

    reference: Array
    """(members, size)"""
    slots: Index
    """For each entry its member, among those of the index, (k,)"""
    columns: Index
    """For each entry its column, (k,)"""
    space: Space = Space.FLAT
    takes = None
    gives = Quantity.PARAMETERS

    def entries(self, index: Index) -> tuple[Index, Index]:
        """Return members and columns of the entries that readings with an index read."""
        return index[self.slots, 0], self.columns

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the differences (k, 1) and their derivatives by a step of each member, (m, k, size, 1)."""
        # the joint prior is a single reading, so that its index has one column
        chosen = local.index(self.block)[:, 0]
        values, reference = local.members(self.block)[chosen], self.reference[chosen]
        by_member = np.zeros((len(chosen), len(self.slots), self.reference.shape[1], 1))
        by_step = self.space.difference_by_step(values, reference)
        by_member[self.slots, np.arange(len(self.slots)), :, 0] = by_step[self.slots, self.columns]
        difference = self.space.difference(values, reference)[self.slots, self.columns]
        return Step(difference[:, None], by_block={self.block: by_member})


def prior_of_members(block: Block, columns: tuple[int, ...], covariance: Array, members: Index) -> Group:
    """Return the joint prior of some columns of some members: their present values with a covariance (m c, m c).

    Its rows run over the columns of the first member, then of the next.
    """
    return joint_prior([(block, np.repeat(members, len(columns)), np.tile(columns, len(members)))], covariance)


@dataclass(frozen=True)
class ReadBlocks:
    """The forward model of a joint prior of several blocks, whose entries are read as one vector."""

    parts: tuple[ReadEntries, ...]
    takes = None
    gives = Quantity.PARAMETERS

    @property
    def blocks(self) -> tuple[str, ...]:
        """The blocks that it reads."""
        return tuple(part.block for part in self.parts)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the differences of all parts, one after the other, (k, 1), and their derivatives."""
        steps = [part.step(value, local) for part in self.parts]
        ends = np.cumsum([len(step.value) for step in steps]).tolist()
        by_block = {}
        for part, step, end in zip(self.parts, steps, ends, strict=True):
            own = step.by_block[part.block]
            full = np.zeros((len(own), ends[-1], *own.shape[2:]))
            full[:, end - own.shape[1] : end] = own
            by_block[part.block] = full
        return Step(np.concatenate([step.value for step in steps]), by_block=by_block)


def joint_prior(parts: Sequence[tuple[Block, Index, Index]], covariance: Array) -> Group:
    """Return the joint prior of entries of blocks: their present values with a common covariance (k, k).

    A part is a block with the members and the columns of its entries: entry i is `block[members[i], columns[i]]`. The
    covariance is that of steps of the entries, part by part.
    """
    links, index, names = list[ReadEntries](), dict[str, Index](), list[str]()
    for block, members, columns in parts:
        used, slots = np.unique(members, return_inverse=True)
        links.append(ReadEntries(block.name, block.values, slots, np.asarray(columns, dtype=np.intp), block.space))
        # (members, 1): one reading that uses all these members at once
        index[block.name] = np.asarray(used, dtype=np.intp)[:, None]
        names += [f"{block.members[i]} {block.columns[k]}".strip() for i, k in zip(members, columns, strict=True)]
    observations = Observations(
        np.zeros((len(covariance), 1)),
        np.ones(1),
        index,
        covariance=np.asarray(covariance, dtype=float)[:, :, None],
        components=tuple(names),
    )
    link = links[0] if len(links) == 1 else ReadBlocks(tuple(links))
    return Group("prior of " + ", ".join(block.name for block, _, _ in parts), Chain((link,)), observations)


def listed_values(blocks: Mapping[str, Block], groups: Iterable[Group]) -> Mapping[str, Block]:
    """Return blocks with the values that their priors state; the given ones if there are no priors of flat columns."""
    values: dict[str, Array] = {}
    for group in groups:
        for link in group.chain.links:
            if isinstance(link, ReadBlock | ReadEntries) and blocks[link.block].space is Space.FLAT:
                index = group.observations.index[link.block]
                own = values.setdefault(link.block, blocks[link.block].values.copy())
                entries = link.entries(index)
                own[entries] = link.reference[entries]
    return {**blocks, **{name: blocks[name].with_values(own) for name, own in values.items()}} if values else blocks
