"""Signatures: the whitened columns that an effect adds to the linearised system of a model.

Method: docs/algorithms/what-can-be-seen.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.chain import LinkContext
from metrocli.adjust.model.derivatives import through
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.linear.projection import Linearised, scatter
from metrocli.effects.effect import Effect
from metrocli.effects.extension import with_effect
from metrocli.effects.links.own import NoValueAtReadingError
from metrocli.effects.model import Model


def nonlinearity(system: Linearised, effect: Effect, scanned: Mapping[str, float], size: float) -> float:
    """Return the second-order share of the visible change by an effect of one place, at a size of each parameter alone.

    `|M (f(s) + f(-s) - 2 f(0))| / |M (f(s) - f(-s))|`, f the whitened predictions; the largest over its parameters. It
    is infinite where a reading cannot be predicted at that size.
    """
    extended = with_effect(system.model, effect, [()], scanned)
    block = extended.blocks[extended.added[-1].block]
    before = system.model.blocks.get(block.name)

    def predicted(step: Array) -> Array:
        blocks = {**extended.blocks, block.name: block.moved(step)}
        rows = np.zeros(system.rows)
        for group in extended.readings:
            own = system.stretch(group)
            rows[own] = -group.residuals(blocks).T.ravel() / system.scale[own]
        return rows

    still = predicted(np.zeros(block.values.shape))
    shares = [0.0]
    for column in np.flatnonzero(block.free[-1]):
        if before is not None and column < before.size and before.free[-1, column]:
            continue
        step = np.zeros(block.values.shape)
        step[-1, column] = size
        up, down = predicted(step), predicted(-step)
        if not np.isfinite(up + down).all():
            return float("inf")
        seen = np.linalg.norm(system.seen(np.stack([up + down - 2 * still, up - down], axis=1)), axis=0)
        shares.append(float(seen[0] / max(seen[1], 1e-300)))
    return max(shares)


def scan(
    system: Linearised, effect: Effect, places: Sequence[tuple[str, ...]], scans: Sequence[Mapping[str, float]]
) -> Iterator[tuple[Array, Block, Mask]]:
    """Yield for each set of scanned values the columns of an effect at some places, (rows, entries).

    Each comes with the block of the effect, and the entries that the model does not estimate yet, (members, size).
    """
    extended = with_effect(system.model, effect, places, scans[0])
    first = extended.blocks[extended.added[-1].block]
    before = system.model.blocks.get(first.name)
    chosen = first.free.copy()
    # entries that the model estimates already are not candidates
    if before is not None:
        chosen[:, : before.size] &= ~before.free
    for values in scans:
        block = _at(first, values) if before is None else first
        blocks = {**extended.blocks, block.name: block}
        full = np.zeros((system.rows, int(chosen.sum())))
        for group in extended.readings:
            # `_whitened` takes the noise of the group; that of the system may be weighted
            columns = _whitened(system, group, blocks, block, chosen) * system.weights_of(group)[:, None]
            full[system.stretch(group)] = columns
        yield full, block, chosen


def scan_with_values(
    system: Linearised,
    effect: Effect,
    places: Sequence[tuple[str, ...]],
    scans: Sequence[Mapping[str, float]],
    needed: bool = True,
) -> Iterator[tuple[Mapping[str, float], tuple[Array, Block, Mask]]]:
    """Yield the scanned values with what `scan` yields, without those at which an own effect has no value at a reading.

    Raises NoValueAtReadingError if it has none at all of them, unless these are not `needed`.
    """
    if not effect.definition:
        yield from zip(scans, scan(system, effect, places, scans) if scans else (), strict=True)
        return
    without: NoValueAtReadingError | None = None
    count = 0
    for values in scans:
        try:
            columns = next(scan(system, effect, places, [values]))
        except NoValueAtReadingError as error:
            without = error
            continue
        count += 1
        yield values, columns
    if without is not None and needed and not count:
        raise without


def of_places(
    model: Model, block: Block, chosen: Mask, places: Sequence[tuple[str, ...]]
) -> Iterator[tuple[tuple[str, ...], tuple[str, ...], Mask]]:
    """Yield each place with its parameters, and which of the chosen entries of an effect's block are its own."""
    member, column = np.nonzero(chosen)
    before = model.blocks.get(block.name)
    for number, place in enumerate(places if chosen.any() else ()):
        # member 0 of a new block belongs to the readings elsewhere, where the effect does not act
        own = member == (number + 1 if len(block.members) > 1 and before is None else _row(block.members, place))
        if not own.any():
            # an effect whose block has no member of the name, as one of the whole
            # chain, has all entries for its one place
            own = np.ones(len(member), dtype=bool) if len(places) == 1 else own
        yield place, tuple(block.columns[i] for i in column[own]), own


def _row(members: Sequence[str], place: tuple[str, ...]) -> int:
    return members.index(place[0]) if place and place[0] in members else 0


def _at(block: Block, values: Mapping[str, float]) -> Block:
    """Return the block of an effect with new values of its scanned parameters at all its places."""
    moved = block.values.copy()
    rows = slice(1, None) if len(block.members) > 1 else slice(None)
    for name, value in values.items():
        moved[rows, block.column(name)] = value
    return replace(block, values=moved)


def _whitened(system: Linearised, group: Group, blocks: Mapping[str, Block], block: Block, chosen: Mask) -> Array:
    """Return the whitened derivatives of a group by the chosen entries of a block, (rows of the group, entries)."""
    numbers = np.full(block.values.shape, -1, dtype=np.intp)
    numbers[chosen] = np.arange(int(chosen.sum()))
    observations = group.observations
    d, n = observations.readings.shape
    full = np.zeros((n, d, int(chosen.sum())))
    if block.name in group.chain.blocks:
        fast = columns_by_splicing(system, group, blocks, block)
        if fast is not None:
            index = LinkContext(blocks, observations, frozenset()).slots(block.name)
            scatter(full, np.broadcast_to(observations.whitened(fast), (d, block.size, n)), numbers[index])
        else:
            for touch in group.linear(blocks, frozenset({block.name})).touches:
                scatter(full, touch.jacobian, numbers[touch.index])
    return full.reshape(n * d, -1)


def columns_by_splicing(system: Linearised, group: Group, blocks: Mapping[str, Block], block: Block) -> Array | None:
    """Return the derivatives (d, size, n) by the block of a link that is inserted into the chain without a change.

    The other links keep their values and derivatives, which saves their evaluation. None if the inserted link changes
    the values, so that the whole chain must be evaluated.
    """
    before = system.model.group(group.name)
    links, old = group.chain.links, before.chain.links
    # identity and not equality: the links of an extended chain are the very objects of the old one
    at = next((i for i, link in enumerate(links) if i == len(old) or link is not old[i]), 0)
    if at == 0 or len(links) != len(old) + 1 or any(a is not b for a, b in zip(links[at + 1 :], old[at:], strict=True)):
        return None
    run = system.run(before)
    value, outer = run.values[at], run.outer[at]
    step = links[at].step(value, LinkContext(blocks, group.observations, frozenset({block.name})))
    inner = step.by_block.get(block.name)
    # an effect at size 0 must leave the values as they are, or all links behind it would have other derivatives
    same = np.array_equal(step.value, np.broadcast_to(value, step.value.shape))
    if inner is None or inner.ndim != 3 or group.weights is not None or not same:
        return None
    return inner if outer is None else through(outer, inner)
