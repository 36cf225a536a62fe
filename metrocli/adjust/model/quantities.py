"""Quantities: what a link takes and gives."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import ClassVar


class Quantity(Enum):
    """A kind of value that a link takes or gives.

    Points of different frames are different quantities, so that links cannot be joined wrongly.
    """

    PARAMETERS = "parameters of a block"
    POINT_ON_BOARD = "point on the board"
    POINT_ON_TARGETS = "point in the frame of the target list (reference or network)"
    POINT_IN_PART = "point in the part"
    BALL_IN_ARTEFACT = "ball in the frame of the artefact"
    BALL_ON_TABLE = "ball in the frame of the view's nominal mounting"
    POINT_IN_MACHINE = "point in the machine"
    POINT_IN_SPINDLE = "point in the spindle"
    POINT_IN_TAPER = "point in the taper of the camera's holder"
    POINT_IN_RIG = "point in the frame of the first of several cameras"
    POINT_IN_CAMERA = "point in the camera"
    IMAGE_POINT = "image point in pixels"
    MACHINE_READING = "point as the machine reads it"
    LENGTH = "length"
    AXIS_ERRORS = "errors of the axes of a machine besides their tables"
    ERROR_MOTION = "displacement and rotation of a machine's tool against its workpiece"
    DISPLACEMENT = "displacement of a machine's tool along a line"
    POINT_IN_TRACKER = "point in the frame of the laser tracker"
    POINT_IN_NETWORK = "point as a network has measured it"
    POLAR = "azimuth, elevation and distance in the frame of an instrument"
    SIGHTING = "readings of a sighting"
    HEIGHT_DIFFERENCE = "height difference"
    ACROSS_LEG = "displacement across a leg of the path"
    BEAM_OUT = "beam from the launch unit to the receiver, in the machine"
    BEAM_BACK = "beam from the receiver to the launch unit, in the machine"
    BEAM_AT_LAUNCH = "beam in the frame of the launch unit"
    BEAM_AT_RECEIVER = "beam in the frame of the receiver"
    LAUNCH_ANGLES = "encoder angles of the launch unit"
    RECEIVER_ANGLES = "encoder angles of the receiver"
    ANGLE = "angle read by one encoder"


@dataclass(frozen=True)
class OfBlock:
    """A link whose unknowns are those of one block."""

    block: str
    others: ClassVar[tuple[str, ...]] = ()
    """Blocks on which it depends besides its own"""

    @property
    def blocks(self) -> tuple[str, ...]:
        """The names of these blocks and of its own."""
        return (*self.others, self.block)


@dataclass(frozen=True)
class AtQuantity(OfBlock):
    """A link that changes the quantity `at`, so that one effect serves several frames or instruments."""

    at: Quantity

    @property
    def takes(self) -> Quantity:
        """The quantity on which it acts."""
        return self.at

    @property
    def gives(self) -> Quantity:
        """The same quantity."""
        return self.at
