"""What an adjustment of image points loses with the readings that are left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.hidden import images
from benchmarks.hidden.scenes import board_scene
from metrocli.adjust.model.groups import prior
from metrocli.instruments.camera import LENS, TARGET
from metrocli.tasks.shared.images.lost import lost_targets


def test_a_target_is_lost_whatever_else_is_known() -> None:
    """A prior of the lens, which concerns no target, ended in an error; that of a target holds it."""
    rng = np.random.default_rng(4)
    model = images.read(board_scene(rng, 3, (5, 4)), rng).adjusted().model
    (group,), lens, targets = model.readings, model.blocks[LENS], model.blocks[TARGET]
    unknown = replace(targets, free=np.ones(targets.values.shape, dtype=bool))
    rest = group.selected(np.flatnonzero(~np.isin(group.observations.index[TARGET], [7, 9])))
    of_lens = prior(lens, np.array([0]), np.ones(lens.values.shape))
    of_target = prior(targets, np.array([9]), np.ones((1, 3)))
    assert lost_targets(unknown, group, rest, [of_lens, of_target]).nonzero()[0].tolist() == [7]
