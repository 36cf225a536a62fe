"""The search of images for the targets of a pattern, and the board that they show instead of it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from metrocli import copies
from metrocli.arrays import Array
from metrocli.errors import Fault, InputError
from metrocli.imageset import ImageSet
from metrocli.table import Columns, Table, columns
from metrocli.targets.find import FoundTargets, find
from metrocli.targets.pattern import Pattern
from metrocli.tasks.shared.images.eccentricity import SIZE
from metrocli.words import listed

OBSERVATIONS = Columns(
    columns("image target [text]", "u v sigma? [pixel]", "t? [time]", "temp? [temperature]"),
    key=("image", "target"),
    description="image coordinates of targets",
    measured=("u", "v"),
    alike=("target",),
    group=("image",),
)
_TRIED = 3
"""Images that are searched first, and in which other boards are sought"""


def sight(images: ImageSet, pattern: Pattern) -> tuple[Table, tuple[str, ...]]:
    """Find the targets of a pattern in images; return them as a table of observations, with warnings.

    A single dot has another place in each image, so it is named after the image (file name without its ending). Raises
    InputError if no image shows a target, or one cannot be read.
    """
    observed = _sought(images, pattern)
    if isinstance(observed, InputError):
        raise InputError(observed.faults)
    return observed


@lru_cache(maxsize=1)
def _sought(images: ImageSet, pattern: Pattern) -> tuple[Table, tuple[str, ...]] | InputError:
    """Return what `sight` returns or raises.

    The last one is kept, whatever it is: other readings of the tables beside the images are tried on the same images
    many times.
    """
    try:
        return _in_all(images, pattern)
    except InputError as error:
        return error


def _in_all(images: ImageSet, pattern: Pattern) -> tuple[Table, tuple[str, ...]]:
    tried = _of_a_few(images, pattern)
    names: list[str] = []
    targets: list[str] = []
    parts: list[Array] = []
    sizes: list[Array] = []
    warnings: list[str] = []
    reasons: dict[str, list[str]] = {}
    for name, picture in images:
        targets_seen = tried[name] if name in tried else find(pattern, picture)
        if targets_seen.reason:
            warnings.append(f"{name}: {targets_seen.reason}")
            reasons.setdefault(targets_seen.reason, []).append(name)
        names += [name] * len(targets_seen.targets)
        targets += (
            [name.rsplit(".", 1)[0]]
            if pattern.type == "dot" and len(targets_seen.targets)
            else list(targets_seen.targets)
        )
        parts.append(targets_seen.uv)
        sizes.append(np.sqrt(targets_seen.axes.prod(axis=1)))
    uv = np.concatenate([*parts, np.zeros((0, 2))])
    if not len(uv):
        hint = "; ".join(f"{listed(shown, 3)}: {reason}" for reason, shown in reasons.items())
        raise InputError([Fault(f"no target found in any of {len(images.names)} images", hint=hint)])
    # the radius of the circle of as large an area: the geometric mean of both half axes
    table = Table.of({"image": names, "target": targets, "u v [px]": uv, SIZE: np.concatenate(sizes)})
    if copied := copies.faults(table, OBSERVATIONS):
        raise InputError(copied)
    return table, tuple(warnings)


def _of_a_few(images: ImageSet, pattern: Pattern) -> dict[str, FoundTargets]:
    """Return what a few images show of the pattern.

    Raises InputError if none shows any, but most of them another board: a search in vain takes a second an image, and
    so minutes where all images are searched.
    """
    chosen = spread(images.names)
    targets = [find(pattern, picture) for picture in images.chosen(chosen)]
    if not any(map(len, targets)) and (board := shown_board(pattern, images, chosen)):
        whole = len(images.names)
        few = f"{listed(chosen)}, which are searched first of {whole} images"
        tried = few if len(chosen) < whole else f"any of {whole} images"
        raise InputError(f"no target found in {tried}{board}")
    return dict(zip(chosen, targets, strict=True))


def spread(names: Sequence[str]) -> Sequence[str]:
    """Return a few names, from the first to the last."""
    places = np.unique(np.linspace(0, len(names) - 1, min(_TRIED, len(names))).round().astype(int))
    return [names[place] for place in places]


def shown_board(pattern: Pattern, images: ImageSet, lost: Sequence[str]) -> str:
    """Return the end of a message, with the board that some of the lost images show; empty without one."""
    from metrocli.targets.likely_board import likely_board  # OpenCV takes longer to load than most jobs without images

    board = likely_board(pattern, images.chosen(spread(lost)))
    return f"; they show {board}" if board else ""
