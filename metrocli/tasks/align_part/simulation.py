"""The truth behind a simulated alignment."""

from __future__ import annotations

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Chain
from metrocli.effects.model import Model
from metrocli.frozen import dataclass
from metrocli.instruments import spindle_camera as spindle
from metrocli.instruments.camera import TARGET, lens_link, target_block
from metrocli.tasks.align_part.camera import CameraModel
from metrocli.tasks.align_part.problem import places_of
from metrocli.tasks.shared.images.adjustment import IMAGES
from metrocli.tasks.shared.images.planted_effects import image_group
from metrocli.tasks.shared.images.simulation import Shown, Sights


@dataclass(frozen=True)
class Truth:
    """True poses and clamping angle of a simulation."""

    part: Array
    """Pose of the part in the machine (6,)"""
    held: Array
    """Poses of the spindle (images, 6)"""
    angle: float
    """Clamping angle [rad]"""


def true_model(camera: CameraModel, shown: Shown, seen: Sights, truth: Truth) -> Model:
    """Return the model of the alignment at the truth, with the exact image points as readings.

    Effects are planted in this model.
    """
    lens, taper = (block.fixed() for block in camera.blocks())
    made = (
        spindle.part_block(truth.part, 1.0, 1.0),
        spindle.coupling_block(truth.angle, free=False),
        lens,
        taper,
        target_block(shown.targets.points, shown.targets.names, False, 1.0),
        spindle.spindle_block(truth.held, shown.images),
    )
    group = image_group(shown, seen, Chain((*spindle.to_camera(), lens_link(camera.convention))), spindle.SPINDLE)
    places = places_of(shown.images, shown.targets.names)
    blocks = {block.name: block for block in made}
    return Model(blocks, (group,), None, (IMAGES,), places, nominal={TARGET: shown.targets.points})
