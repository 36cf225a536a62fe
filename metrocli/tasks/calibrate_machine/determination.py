"""What the readings of a calibration determine of an error."""

from __future__ import annotations

from enum import StrEnum


class Determination(StrEnum):
    """What the readings determine of an error."""

    DETERMINED = "determined"
    TOGETHER = "together"
    """Only combined with errors that are held at zero"""
    UNDETERMINED = "undetermined"
    """Held at zero"""
    NOT_ESTIMATED = "not estimated"
