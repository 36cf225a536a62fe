"""Starts of calibrations with unknown targets: poses by the listed targets, targets by the poses, then all at once.

Method: docs/algorithms/robust-start.md (unknown targets).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Protocol, Self, TypeVar

import numpy as np

from metrocli.adjust.adjustment import Control, adjust
from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Mask
from metrocli.adjust.robust import gross, robust_start
from metrocli.instruments import camera
from metrocli.tasks.shared.images.adjustment import IMAGES

_AGAIN = 3
"""Most starts from poses found anew, if targets or images strayed"""
_STEPS = 15
"""Most steps in which targets follow poses"""
_FOCAL = ("f", "fx", "fy")


class Calibration(Protocol):
    """What a start needs of a calibration."""

    @property
    def rig(self) -> str:
        """board, cmm or network."""

    @property
    def blocks(self) -> Mapping[str, Block]:
        """The blocks of unknowns."""

    @property
    def images(self) -> Group:
        """The image points."""

    @property
    def others(self) -> tuple[Group, ...]:
        """Priors and conditions."""

    @property
    def datum(self) -> Datum | None:
        """The datum that fixes the frame of a free network."""

    def with_blocks(self, blocks: Mapping[str, Block]) -> Self:
        """Return a copy with other values of the blocks."""


P = TypeVar("P", bound=Calibration)
Resection = Callable[[P, Array], P]
"""Takes a calibration and places of its targets (n, 3), and returns it with poses found anew by these targets"""


def robustly(problem: P) -> P:
    """Adjust with weights that gross errors do not spoil.

    The unknown targets of a network follow poses that the listed ones gave. While lens and poses are far off, a target
    that is free as well can move so far that all its readings are given up.
    """
    if problem.rig == "network" and _has_unknown(problem):
        problem = _by_turns(problem)
    return problem.with_blocks({**problem.blocks, **_robust(problem, problem.blocks, problem.datum)})


def without_strays(listed: Array, best: P, resected: Resection[P]) -> P:
    """Return the best of several starts: `best`, and while targets or images stray, one from poses found anew.

    The poses are those by its targets; targets that stray are back at their listed places (n, 3).
    """
    for _ in range(_AGAIN if _has_unknown(best) else 0):
        targets, count = _strayed(best, camera.TARGET), _strays(best)
        if not count:
            break
        places = np.where(targets[:, None], listed, best.blocks[camera.TARGET].values)
        again = robustly(resected(best, places))
        if _strays(again) >= count:
            break
        best = again
    return best


def _has_unknown(problem: Calibration) -> bool:
    return bool(problem.blocks[camera.TARGET].free.any())


def _by_turns(problem: P) -> P:
    """Return a calibration with poses and the focal length for its targets as they are, then targets for these."""
    lens = problem.blocks[camera.LENS]
    focal = replace(lens, free=lens.free & np.isin(lens.columns, _FOCAL))
    held = {camera.LENS: focal, camera.TARGET: problem.blocks[camera.TARGET].fixed()}
    problem = _valued(problem, _robust(problem, {**problem.blocks, **held}))
    held = {name: block.fixed() for name, block in problem.blocks.items() if name != camera.TARGET}
    blocks = {**problem.blocks, **held}
    # a target has its own readings only: one that wrong readings spoil spoils no other
    found = adjust(blocks.values(), [problem.images, *problem.others], None, Control(limit=_STEPS, covariance=False))
    return _valued(problem, found.blocks)


def _robust(problem: Calibration, blocks: Mapping[str, Block], datum: Datum | None = None) -> Mapping[str, Block]:
    return robust_start(blocks.values(), [problem.images, *problem.others], IMAGES, datum, camera.VIEW)


def _valued(problem: P, found: Mapping[str, Block]) -> P:
    """Return a calibration with the values that were found, and with its own unknowns."""
    return problem.with_blocks({name: one.with_values(found[name].values) for name, one in problem.blocks.items()})


def _strays(problem: Calibration) -> int:
    """Return the number of unknown targets and of images that most of their readings contradict."""
    return int(_strayed(problem, camera.TARGET).sum() + _strayed(problem, camera.VIEW).sum())


def _strayed(problem: Calibration, name: str) -> Mask:
    """Return the members of a block with unknowns (n,) that most of their readings contradict."""
    block, index = problem.blocks.get(name), problem.images.observations.index.get(name)
    if block is None or index is None:
        return np.zeros(0, dtype=bool)
    far = np.bincount(index, gross(problem.images, problem.blocks) > 0, minlength=len(block.members))
    return np.asarray(block.free.any(axis=1) & (2 * far > np.bincount(index, minlength=len(block.members))))
