"""Effects in simulated image points: the job's chain of links predicts the readings, with the effects in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.effects.estimates import true_values
from metrocli.effects.extension import extended
from metrocli.effects.model import Model
from metrocli.effects.wanted import Wanted
from metrocli.errors import InputError, UsageError
from metrocli.instruments.camera import TARGET
from metrocli.tasks.shared.images.adjustment import IMAGES
from metrocli.tasks.shared.images.simulation import Shown, Sights

_ROUNDS = 50
"""Iteration limit for the image points of a backward lens"""
_SETTLED = 1e-10
"""The image points have converged when a round changes them by less than this [px]"""


def image_group(shown: Shown, seen: Sights, chain: Chain, poses: str) -> Group:
    """Return the image points as readings of a chain; `poses` names the block with a pose for each image."""
    index = {"view": seen.view, poses: seen.view, TARGET: seen.target}
    conditions = {name: values[seen.view] for name, values in shown.conditions.items()}
    conditions["radius"] = shown.targets.radius[seen.target]
    return Group(IMAGES, chain, Observations(seen.uv, np.ones(1), index, conditions=conditions))


def planted(model: Model, seen: Sights, effects: Sequence[Wanted]) -> tuple[Sights, dict[str, float]]:
    """Return the image points with effects in them, and the true values of the effects by name.

    `model` is the model of the job at the truth.
    """
    if not effects:
        return seen, {}
    model = extended(model, effects)
    return replace(seen, uv=_image_points(model)), true_values(model)


def refuse_pictures(effects: Sequence[Wanted]) -> None:
    """Raise UsageError if there are effects: they are planted in image points, not in rendered pictures."""
    if effects:
        raise UsageError("effects are planted in image points, not in pictures: leave out --images or --effect")


def _image_points(model: Model) -> Array:
    """Return the readings that agree with their prediction, (2, n) px.

    A forward lens predicts them directly. A backward lens takes its correction at the reading, so they are iterated.
    Raises InputError if the camera no longer sees a target.
    """
    group = model.readings[0]
    for _ in range(_ROUNDS):
        found = group.chain.predict(model.blocks, group.observations)
        if not np.isfinite(found).all():
            raise InputError("simulation: with this effect the camera does not see every target; check its size")
        change = float(np.abs(found - group.observations.readings).max(initial=0.0))
        group = group.with_observations(group.observations.with_readings(found))
        if change < _SETTLED:
            break
    return group.observations.readings
