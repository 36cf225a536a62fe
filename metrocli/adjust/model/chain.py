"""Chains: links one after the other, the forward model of one kind of reading, with derivatives by the chain rule."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from typing import Protocol

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.derivatives import by_slots, through
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Step:
    """Value of a link and its derivatives; the observation axis is the last one."""

    value: Array
    """(out, n)"""
    by_input: Array | None = None
    """(out, in, n); None for the first link of a chain, and for one that adds to its input"""
    by_block: Mapping[str, Array] = field(default_factory=dict)
    """(out, size, n), or (k, out, size, n) where a reading touches k members of the block"""


@dataclass(frozen=True)
class LinkContext:
    """What a link needs: values of the blocks, which members each reading uses, the readings and their conditions."""

    blocks: Mapping[str, Block]
    observations: Observations
    wanted: frozenset[str]
    """Blocks whose derivatives are used; a link may leave out the others"""

    def members(self, block: str) -> Array:
        """Return the values of all members of a block, (members, size)."""
        return self.blocks[block].values

    def index(self, block: str) -> Index:
        """Return which member of the block each reading uses, (n,) or (k, n); zeros for a block of one member."""
        index, lattice = self.observations.index.get(block), self.observations.lattice
        if index is not None:
            return index
        if lattice is not None and (block == lattice.block or block in lattice.slots):
            return lattice.index(block)
        return np.zeros(self.observations.count, dtype=np.intp)

    def slots(self, block: str) -> Index:
        """Return which member each reading uses, or each slot of a lattice; a single 0 for the lattice's own block."""
        lattice = self.observations.lattice
        if lattice is None:
            return self.index(block)
        return lattice.slots.get(block, np.zeros(1, dtype=np.intp))

    def rows(self, block: str) -> Array:
        """Return the values of the block that each reading uses, (size, n), or (size, 1) for a block of one member."""
        values = self.blocks[block].values
        if len(values) == 1:
            return values.T
        return self._at_readings(values, block)

    def spread(self, per_member: Array, block: str) -> Array:
        """Return values computed once for each member (members, ...) at the readings, (..., n) or (..., 1)."""
        return np.moveaxis(per_member, 0, -1) if len(per_member) == 1 else self._at_readings(per_member, block)

    def _at_readings(self, per_member: Array, block: str) -> Array:
        lattice = self.observations.lattice
        if lattice is not None and block not in self.observations.index:
            return lattice.spread(per_member, block)
        index = self.index(block)
        # a chunk of readings uses few members of many; "clip" skips the check of the indices, which are all within
        first, last = index.min(initial=len(per_member)), index.max(initial=-1)
        used = np.moveaxis(per_member[first : last + 1], 0, -1)
        chosen: Array = np.ascontiguousarray(used).take(index - first, axis=-1, mode="clip")
        return chosen


IDENTITY = np.eye(3)[:, :, None]
"""Derivative of a point by itself, (3, 3, 1); recognised by identity, so that products with it are skipped"""


class Link(Protocol):
    """One differentiable step from a quantity to a quantity.

    Readings come in tiles and in any order. So a link asks `local` for what differs between readings and never stores
    it.
    """

    @property
    def takes(self) -> Quantity | None:
        """The quantity that the link takes; None for the first link of a chain."""

    @property
    def gives(self) -> Quantity:
        """The quantity that the link gives."""

    @property
    def blocks(self) -> tuple[str, ...]:
        """Names of the blocks whose values the link uses."""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the value (out, n) and its derivatives at the input `value` (in, n)."""


@dataclass(frozen=True)
class Chain:
    """Links in order; each takes what the previous one gives."""

    links: tuple[Link, ...]

    def __post_init__(self) -> None:
        given: Quantity | None = None
        for link in self.links:
            if link.takes is not given:
                wants = "nothing" if link.takes is None else f"a {link.takes.value}"
                has = "nothing" if given is None else f"a {given.value}"
                raise ValueError(f"{type(link).__name__} takes {wants}, the chain has {has} there")
            given = link.gives

    @property
    def blocks(self) -> tuple[str, ...]:
        """Names of all blocks that the chain uses, in order, without repetition."""
        return tuple(dict.fromkeys(name for link in self.links for name in link.blocks))

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """The quantities that the chain passes through."""
        return tuple(link.gives for link in self.links)

    def spliced(self, effects: Sequence[Link]) -> Chain:
        """Return the chain with each effect inserted behind the last link that gives its quantity.

        An effect on the parameters of a block (its `varies` names the block) is inserted before every link that uses
        the block. An effect that needs the links before it has a method `within`, which is called with the chain of
        these links. Raises ValueError, with the list of quantities that the chain passes through, if an effect cannot
        act.
        """
        links = self.links
        for effect in effects:
            inserted = _inserted(links, effect)
            if inserted is None:
                passed = ", ".join(quantity.value for quantity in self.quantities)
                raise ValueError(f"{type(effect).__name__} cannot act here: the chain passes through {passed}")
            links = inserted
        return Chain(links)

    def until(self, quantity: Quantity) -> Chain:
        """Return the links that lead to a quantity, effects on it included."""
        return Chain(self.links[: len(self.links) - self.quantities[::-1].index(quantity)])

    def takes(self, effect: Link) -> bool:
        """Return whether an effect can be inserted into the chain."""
        return _inserted(self.links, effect) is not None

    def predict(self, blocks: Mapping[str, Block], observations: Observations) -> Array:
        """Return the predicted readings (d, n)."""
        value = self.steps(blocks, observations, frozenset())[-1].value
        return np.array(np.broadcast_to(value, (len(value), observations.count)))

    def steps(self, blocks: Mapping[str, Block], observations: Observations, wanted: frozenset[str]) -> list[Step]:
        """Evaluate the chain from first to last link and return the step of each."""
        local = LinkContext(blocks, observations, wanted)
        value = np.zeros((0, observations.count))
        steps = []
        for link in self.links:
            steps.append(link.step(value, local))
            value = steps[-1].value
        return steps

    def derivatives(self, steps: Sequence[Step], wanted: frozenset[str]) -> dict[str, Array]:
        """Return the derivatives of the reading by the wanted blocks, computed backwards along the chain.

        Each is (d, size, n), or (k, d, size, n) if a reading uses k members of the block.
        """
        first = min(
            (i for i, link in enumerate(self.links) if wanted.intersection(link.blocks)), default=len(self.links)
        )
        total: dict[str, Array] = {}
        outer: Array | None = None
        for i in range(len(self.links) - 1, first - 1, -1):
            for name, inner in steps[i].by_block.items():
                if name in wanted:
                    part = _chained(outer, inner)
                    total[name] = total[name] + part if name in total else part
            by_input = steps[i].by_input
            # nothing in front of the first link with a wanted block is differentiated
            if i > first and by_input is not None:
                outer = by_input if outer is None else through(outer, by_input)
        return total


@dataclass(frozen=True)
class Varied:
    """A link whose block has other parameters for each reading, because an effect changes them."""

    link: Link
    block: str
    effect: Link
    """Takes and gives the values of the block that each reading uses, (size, n)"""

    @property
    def takes(self) -> Quantity | None:
        """What the link takes."""
        return self.link.takes

    @property
    def gives(self) -> Quantity:
        """What the link gives."""
        return self.link.gives

    @property
    def blocks(self) -> tuple[str, ...]:
        """Blocks of the link and of the effect."""
        return tuple(dict.fromkeys((*self.link.blocks, *self.effect.blocks)))

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the link's step at the changed parameters; derivatives by the block pass through the effect."""
        rows = local.rows(self.block)
        # of a reading that uses several members, the effect takes one slot after the other
        own = np.array(np.broadcast_to(rows, (*rows.shape[:-1], local.observations.count))).reshape(len(rows), -1)
        changed = self.effect.step(own, local)
        step = self.link.step(value, self._context(np.broadcast_to(changed.value, own.shape), local))
        by_block = dict(step.by_block)
        outer = by_block.pop(self.block, None)
        if outer is not None:
            for name, inner in changed.by_block.items():
                part = sum(by_slots(outer, inner), np.zeros(1))
                by_block[name] = by_block[name] + part if name in by_block else part
            if changed.by_input is not None:
                parts = by_slots(outer, changed.by_input)
                outer = np.stack(parts) if outer.ndim == 4 else parts[0]
            by_block[self.block] = outer
        return replace(step, by_block={name: part for name, part in by_block.items() if name in local.wanted})

    def _context(self, values: Array, local: LinkContext) -> LinkContext:
        """Return the context of the link, in which the block has a member of its own for each reading and slot.

        All columns of the block have derivatives if those of the effect are wanted: they are needed for the chain rule.
        """
        block, observations, wanted = local.blocks[self.block], local.observations, local.wanted
        used = block.free.any(axis=0)
        if wanted.intersection(self.effect.blocks):
            used, wanted = np.array(True), wanted | {self.block}
        before = local.index(self.block)
        # they keep their names, by which another effect may know its own
        members = tuple(block.members[i] for i in before.ravel().tolist())
        each = replace(block, values=values.T, members=members, free=np.asarray(used))
        index = {**observations.index, self.block: np.arange(before.size).reshape(before.shape)}
        # in a lattice the other blocks stay as they are
        return LinkContext({**local.blocks, self.block: each}, replace(observations, index=index), wanted)


def _inserted(links: tuple[Link, ...], effect: Link) -> tuple[Link, ...] | None:
    """Return the links with an effect inserted; None if it cannot act."""
    block: str | None = getattr(effect, "varies", None)
    if block is None:
        return _behind_last(links, effect)
    if not any(block in link.blocks for link in links):
        return None
    return tuple(Varied(link, block, effect) if block in link.blocks else link for link in links)


def _behind_last(links: tuple[Link, ...], effect: Link) -> tuple[Link, ...] | None:
    places = [i + 1 for i, link in enumerate(links) if link.gives is effect.takes is effect.gives]
    if not places:
        return None
    before = links[: places[-1]]
    within = getattr(effect, "within", None)
    return (*before, effect if within is None else within(Chain(before)), *links[places[-1] :])


def _chained(outer: Array | None, inner: Array) -> Array:
    if outer is None:
        return inner
    if inner is IDENTITY:
        return outer
    if inner.ndim == 4:  # k members of the block for each reading
        return np.stack([through(outer, slot) for slot in inner])
    return through(outer, inner)
