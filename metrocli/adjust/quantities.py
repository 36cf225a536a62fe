"""What flows through a chain."""

from __future__ import annotations

from enum import Enum


class Quantity(Enum):
    """A kind of value that a link takes or gives; frames are told apart so that chains cannot be joined wrongly."""

    PARAMETERS = "parameters of a block"
    POINT_ON_TARGETS = "point in the frame of the target list (board, reference or network)"
    POINT_IN_PART = "point in the part"
    BALL_IN_ARTEFACT = "ball in the frame of the artefact"
    BALL_ON_TABLE = "ball in the frame of the view's nominal mounting"
    POINT_IN_MACHINE = "point in the machine"
    POINT_IN_SPINDLE = "point in the spindle"
    POINT_IN_TAPER = "point in the taper of the camera's holder"
    POINT_IN_CAMERA = "point in the camera"
    IDEAL_IMAGE_POINT = "image point without distortion, in the plane at distance 1"
    IMAGE_POINT = "image point in pixels"
    MACHINE_READING = "point as the machine reads it"
    LENGTH = "length"
