"""Adjustments that begin with the principal point in the middle of the image."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.instruments.camera import LENS

POINT = ("cx", "cy")
Blocks = Mapping[str, Block]


def held_in_the_middle(blocks: Blocks, size: tuple[int, int], adjusted: Callable[[Blocks], Blocks]) -> dict[str, Block]:
    """Return blocks `adjusted` with the principal point held in the middle of an image of a size, which is free again.

    The shift `s r^2` of a thin prism is nearly what a principal point far off, tilted views and decentring do. Where
    these have taken its place, a small prism of the wrong sign is at a minimum of its own beside them.
    """
    lens = blocks[LENS]
    chosen = np.isin(lens.columns, POINT)
    middle = np.array([(size[POINT.index(name)] - 1) / 2 for name in lens.columns if name in POINT])
    values = lens.values.copy()
    values[:, chosen] = middle
    held = adjusted({**blocks, LENS: replace(lens, values=values, free=lens.free & ~chosen)})
    return {name: block.with_values(held[name].values) for name, block in blocks.items()}
