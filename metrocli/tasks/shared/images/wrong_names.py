"""Wrong names of targets: two that are exchanged in an image, and rows whose names stand one row too high or low."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.robust import gross
from metrocli.diagnosis.corrections import ROWS, Mistake
from metrocli.instruments.camera import TARGET
from metrocli.table import Table
from metrocli.words import in_a_row, listed

_NEAR = 0.1
"""Share of the distance of two readings within which one stands at the place of the other's target"""
_MOST = 20
"""Most pairs that are tried one by one"""
_STEPS = 100
"""Most steps of a try; a network of images takes 30"""
_LARGEST = 1e6
"""Residuals beyond so many standard deviations count alike: of points without an image they are infinite"""
_Pair = tuple[str, str, str]
"""An image, and two targets"""


_SOME = 0.05
"""Share of gross readings from which all names of an image may be wrong: a board that is named from its neighbours
fits one that is shifted by a step, but at the ends of its rows"""
_Calibration = tuple[Group, Mapping[str, Block]]
"""Image points, and values of a start that single wrong readings do not spoil"""


def wrong_names(calibrations: Sequence[_Calibration], table: Table) -> Iterator[tuple[Mistake, Table]]:
    """Yield how targets may be named wrongly, with the table of readings that is right then.

    First are all pairs of which each reading stands at the place of the other target, together. Then come names that
    are one row off, and pairs of which one reading does, as a wrong one may have pulled the other target away.
    """
    crossed = [_crossed(*each) for each in calibrations]
    both, single = ([pair for found in crossed for pair in found[which]] for which in (0, 1))
    if both:
        yield _exchanged(table, both)
    for images in _suspects(calibrations):
        yield from _one_row_off(table, images)
    yield from (_exchanged(table, [pair]) for pair in single[:_MOST])


def _mistake(table: Table, words: str, write: str) -> Mistake:
    return Mistake("observations", words, write, file=table.file, sort=ROWS, columns=0, steps=_STEPS)


def _exchanged(table: Table, pairs: list[_Pair]) -> tuple[Mistake, Table]:
    words = [f"{one} and {other} are exchanged in image {image}" for image, one, other in pairs]
    write = [f"{other} for {one} and {one} for {other} in the rows of {image}" for image, one, other in pairs]
    return _mistake(table, in_a_row(words), in_a_row(write)), _swapped(table, pairs)


def _suspects(calibrations: Sequence[_Calibration]) -> list[list[str]]:
    """Return the image of which the most is gross, if it may be named wrongly as a whole, and all that may."""
    size = dict[str, float]()
    for group, blocks in calibrations:
        sizes, images = gross(group, blocks), np.array(group.observations.keys["image"])
        for image in dict.fromkeys(images.tolist()):
            mine = np.minimum(sizes[images == image], _LARGEST)
            if np.count_nonzero(mine) > _SOME * len(mine):
                size[image] = float(np.mean(mine**2))
    return [[max(size, key=size.__getitem__)], list(size)][: len(size)] if size else []


def _one_row_off(table: Table, images: list[str]) -> Iterator[tuple[Mistake, Table]]:
    """Yield the names of targets moved by one row in the rows of some images, as one inserted cell moves them."""
    names, rows = np.array(table.texts("target")), np.flatnonzero(np.isin(table.texts("image"), images))
    of = f"{'images' if images[1:] else 'image'} {listed(images)}"
    for step, off, back in ((1, "high", "lower"), (-1, "low", "higher")):
        right = names.copy()
        right[rows] = np.roll(names[rows], step)
        words = f"the names of targets in the rows of {of} stand one row too {off}"
        yield _mistake(table, words, f"the names of {of} one row {back}"), table.changed({"target": right})


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
