"""What flows through a chain."""

from __future__ import annotations

from enum import Enum


class Quantity(Enum):
    """A kind of value that a link takes or gives; frames are told apart so that chains cannot be joined wrongly."""

    PARAMETERS = "parameters of a block"
    POINT_ON_BOARD = "point on the board"
    POINT_ON_TARGETS = "point in the frame of the target list (reference or network)"
    POINT_IN_PART = "point in the part"
    POINT_IN_MACHINE = "point in the machine"
    POINT_IN_SPINDLE = "point in the spindle"
    POINT_IN_TAPER = "point in the taper of the camera's holder"
    POINT_IN_CAMERA = "point in the camera"
    IDEAL_IMAGE_POINT = "image point without distortion, in the plane at distance 1"
    IMAGE_POINT = "image point in pixels"
    LENGTH = "length"
