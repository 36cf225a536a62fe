"""Names of two targets that are exchanged in an image: each reading stands where the other target is seen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.robust import gross
from metrocli.diagnosis.corrections import ROWS, Mistake
from metrocli.instruments.camera import TARGET
from metrocli.table import Table
from metrocli.words import in_a_row

_NEAR = 0.1
"""Share of the distance of two readings within which one stands at the place of the other's target"""
_MOST = 20
"""Most pairs that are tried one by one"""
_STEPS = 100
"""Most steps of a try; a network of images takes 30"""
_Pair = tuple[str, str, str]
"""An image, and two targets"""


def exchanged_targets(group: Group, blocks: Mapping[str, Block], table: Table) -> Iterator[tuple[Mistake, Table]]:
    """Yield targets whose names may be exchanged in an image, with the table of readings that is right then.

    Values of `blocks` are those of a start that single wrong readings do not spoil. First are all pairs of which each
    reading stands at the place of the other target, together; then pairs of which one does, as a wrong reading may
    have pulled the other target away.
    """
    both, single = _crossed(group, blocks)
    for pairs in ([both] if both else []) + [[pair] for pair in single[:_MOST]]:
        words = [f"{one} and {other} are exchanged in image {image}" for image, one, other in pairs]
        write = [f"{other} for {one} and {one} for {other} in the rows of {image}" for image, one, other in pairs]
        mistake = Mistake(
            "observations", in_a_row(words), in_a_row(write),
            file=table.file, sort=ROWS, columns=0, steps=_STEPS,
        )  # fmt: skip
        yield mistake, _swapped(table, pairs)


def _crossed(group: Group, blocks: Mapping[str, Block]) -> tuple[list[_Pair], list[_Pair]]:
    """Return the pairs of which both readings stand at the place of the other target, and those of which one does."""
    observations = group.observations
    images, targets = (np.array(observations.keys[key]) for key in ("image", "target"))
    listed = observations.index[TARGET]
    sizes, places = gross(group, blocks), group.chain.predict(blocks, observations)
    both, single = list[_Pair](), list[tuple[float, _Pair]]()
    for image in dict.fromkeys(images[sizes > 0].tolist()):
        rows = np.flatnonzero((images == image) & (sizes > 0))
        if 2 * len(rows) > np.count_nonzero(images == image):
            continue  # its targets are in another order, or it is mirrored
        for a, b in combinations(rows[np.argsort(-sizes[rows], kind="stable")][:_MOST].tolist(), 2):
            off = [np.linalg.norm(observations.readings[:, i] - places[:, j]) for i, j in ((a, b), (b, a))]
            share = np.array(off) / max(float(np.linalg.norm(np.subtract(*observations.readings.T[[a, b]]))), 1e-12)
            first, second = sorted((a, b), key=listed.__getitem__)
            pair = str(image), str(targets[first]), str(targets[second])
            if share.max() < _NEAR:
                both.append(pair)
            elif share.min() < _NEAR:
                single.append((float(share.min()), pair))
    return both, [pair for _, pair in sorted(single)]


def _swapped(table: Table, pairs: list[_Pair]) -> Table:
    """Return the table of readings with the names of each pair exchanged in its image."""
    images, names = np.array(table.texts("image")), np.array(table.texts("target"), dtype=object)
    right = names.copy()
    for image, first, second in pairs:
        for name, other in ((first, second), (second, first)):
            right[(images == image) & (names == name)] = other
    return table.changed({"target": right.astype(str)})
