"""What an adjustment of image points loses with the readings that are left out: poses, targets, whole images."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.arrays import Array, Mask
from metrocli.instruments.camera import TARGET
from metrocli.table import Table

_PLACED = 2
"""Readings that place a target"""


def without_lost_views(blocks: Mapping[str, Block], group: Group) -> Mapping[str, Block]:
    """Return the blocks; the pose of an image that lost all readings is not an unknown: nothing else depends on it."""
    view = blocks.get("view")
    if view is None:
        return blocks
    left = np.bincount(group.observations.index["view"], minlength=len(view.members)) > 0
    return blocks if left.all() else {**blocks, "view": replace(view, free=view.free & left[:, None])}


def lost_targets(block: Block, whole: Group, used: Group, others: Sequence[Group]) -> Mask:
    """Return which unknown targets lost so many of their readings that the rest does not place them, (targets,).

    A target that a list or a scale bar holds, one of `others`, is not lost: it is needed there.
    """
    read, left = (
        np.bincount(group.observations.index[TARGET], minlength=len(block.members)) for group in (whole, used)
    )
    lost = (left < _PLACED) & (left < read) & np.broadcast_to(block.free, block.values.shape).any(axis=1)
    for group in others:
        if TARGET in group.observations.index:
            lost[group.observations.index[TARGET]] = False
    return np.asarray(lost)


def without_targets(
    lost: Mask, blocks: Mapping[str, Block], group: Group, datum: Datum | None
) -> tuple[Mapping[str, Block], Group, Datum | None]:
    """Return the blocks in which lost targets are no unknowns, the other readings, and a datum on other targets."""
    block = blocks[TARGET]
    fewer = {**blocks, TARGET: replace(block, free=block.free & ~lost[:, None])}
    if datum is not None and datum.block == TARGET:
        datum = replace(datum, members=datum.members * ~lost)
    return fewer, group.selected(np.flatnonzero(~lost[group.observations.index[TARGET]])), datum


def apart_from_others(group: Group, rest: Group, left_out: Table) -> list[str]:
    """Return the images most of whose readings were left out of an adjustment, which used `rest`."""
    wrong, fitting = Counter(left_out.texts("image")), Counter(rest.observations.keys["image"])
    images = dict.fromkeys(group.observations.keys["image"])
    return [name for name in images if wrong[name] > fitting[name]]


def rejected(group: Group, tests: Array) -> Table:
    """Return the table `rejected` of the readings left out, from the test value w of each reading (n,), 0 if used.

    w is nan where a reading left with its target.
    """
    rows, keys = np.flatnonzero(tests), group.observations.keys
    columns = {f"{key} [text]": [keys[key][i] for i in rows] for key in ("image", "target")}
    return Table.of({**columns, "u v [px]": group.observations.readings[:, rows].T, "w": tests[rows]})
