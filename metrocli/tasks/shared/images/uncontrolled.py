"""What no residual of an image job can show, as far as calibrate-camera and align-part share it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.groups import Group
from metrocli.instruments.camera import TARGET
from metrocli.tasks.shared.images.eccentricity import imaged
from metrocli.tasks.shared.images.imaged_size import SIZE, allowed_share
from metrocli.tasks.shared.uncontrolled import Hidden

_UNSEEN = 0.05
"""Error of a radius that is assumed where no image shows the targets"""


def diameters(group: Group, blocks: Mapping[str, Block], radius: Array) -> Iterator[Hidden]:
    """Yield what a wrong diameter of the targets hides, if their eccentricity is corrected by it.

    The correction s [px] grows with the square of the radius r. A relative error q of r moves a reading by `2 q s` px.
    That is `2 q s r / r'` mm at the target, r' [px] the imaged radius.
    """
    shift, size = imaged(group, blocks, radius)
    at_target = radius[group.observations.index[TARGET]]
    seen = group.observations.conditions.get(SIZE)
    shown = seen is not None and bool(np.isfinite(seen).any())
    share = allowed_share(size) if shown else np.full(len(size), _UNSEEN)
    moved = 2 * share * np.linalg.norm(shift, axis=0) * at_target / np.where(size > 0, size, np.inf)
    yield Hidden(
        "diameter of the targets (places of targets by their eccentricity)",
        "2 % and 0.25 px of the imaged radius" if shown else "5 % of the radius",
        float(np.nanmax(moved, initial=0.0)),
        "the diameter measured on the targets" if shown else "images in place of observations, which show the size",
    )
