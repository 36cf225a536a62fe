"""The lenses of several cameras, each with its own formula: of one a pinhole, of another a fisheye."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.chain import Link, LinkContext, Step
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class LensOfEach(OfBlock):
    """Link to the image of a point in the camera, by the lens of the camera that took it."""

    block: str
    lenses: tuple[Link, ...]
    """The link of each camera"""
    by: str
    """The block with a member for each camera; an effect on the lens may give it other members"""
    takes = Quantity.POINT_IN_CAMERA
    gives = Quantity.IMAGE_POINT

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return (u, v) [px] (2, n), with derivatives by the point (2, 3, n) and the parameters (2, size, n)."""
        # not by the member of the lens: an effect may have given each reading its own (docs/decisions/259)
        camera, member, o = local.index(self.by), local.index(self.block), local.observations
        taken: list[int] = np.unique(camera).tolist()
        if len({self.lenses[number] for number in taken}) == 1:
            return self.lenses[taken[0]].step(value, local)
        n, size = o.count, local.blocks[self.block].size
        uv, by_point, by_lens = np.empty((2, n)), np.zeros((2, 3, n)), np.zeros((2, size, n))
        for lens in dict.fromkeys(self.lenses[number] for number in taken):
            # by equality: cameras of one convention share their link and are taken together
            mine = np.isin(camera, [number for number in taken if self.lenses[number] == lens])
            own = Observations(o.readings[:, mine], o.sigma[:, mine], {self.block: member[mine]})
            step = lens.step(value[:, mine], LinkContext(local.blocks, own, local.wanted))
            uv[:, mine] = step.value
            if step.by_input is not None:
                by_point[:, :, mine] = step.by_input
            if self.block in step.by_block:
                by_lens[:, :, mine] = step.by_block[self.block]
        if not local.wanted:
            return Step(uv)
        return Step(uv, by_point, {self.block: by_lens} if self.block in local.wanted else {})
