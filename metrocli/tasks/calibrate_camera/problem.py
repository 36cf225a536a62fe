"""The adjustment of a camera calibration: its model, and what changes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.arrays import Mask
from metrocli.effects.modelled import Modelled
from metrocli.frozen import dataclass
from metrocli.instruments import camera
from metrocli.tasks.shared.images.adjustment import IMAGES
from metrocli.tasks.shared.images.sightings import Sighted


@dataclass(frozen=True)
class CameraProblem(Modelled):
    """A camera calibration ready to adjust."""

    rig: str
    convention: str
    image_size: tuple[int, int]
    sighted: Sighted

    @property
    def images(self) -> Group:
        """The image points."""
        return self.model.group(IMAGES)

    def with_estimate(self, estimate: Sequence[str]) -> CameraProblem:
        """Return the problem with these lens parameters free; all others are fixed at their values."""
        lens = self.blocks[camera.LENS]
        free = replace(lens, free=np.isin(lens.columns, list(estimate)))
        return self.with_blocks({**self.blocks, camera.LENS: free})

    def with_lens(self, values: Mapping[str, float]) -> CameraProblem:
        """Return the problem with these values of lens parameters; the others keep theirs.

        Parameters that are new to the problem are fixed.
        """
        lens = self.blocks[camera.LENS]
        known = {**lens.named(), **values}
        free = [name for name, is_free in zip(lens.columns, lens.free[0], strict=True) if is_free]
        return self.with_blocks({**self.blocks, camera.LENS: camera.lens_block(known, free, self.image_size)})

    def of_images(self, chosen: Mask) -> CameraProblem:
        """Return the problem with the chosen images only (a mask over all), their readings and their poses."""
        keep = chosen[self.images.observations.index["view"]]
        numbers = np.cumsum(chosen) - 1
        observations = self.images.observations.selected(keep)
        observations = observations.with_index({"view": numbers[observations.index["view"]]})
        model = self.model.with_group(self.images.with_observations(observations))
        if self.rig == "cmm":
            return self.with_model(model)
        views = self.blocks[camera.VIEW]
        members = tuple(name for name, c in zip(views.members, chosen, strict=True) if c)
        blocks = {
            **self.blocks,
            camera.VIEW: replace(views, values=views.values[chosen], members=members, free=views.free[chosen]),
        }
        return self.with_model(model.with_blocks(blocks))
