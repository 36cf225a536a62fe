"""Effects on the lengths of a network."""

from __future__ import annotations

from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.acting import point
from metrocli.tasks.shared.length_effects import AT, BEAM, DIRECTION, LENGTH_EFFECTS, length

EFFECTS = LENGTH_EFFECTS
"""The table of effects in the order of lists"""

PLACES = (length(), point("point-in-machine", Quantity.POINT_IN_MACHINE, AT, *BEAM, *DIRECTION))
"""Quantities on which user-defined effects can act"""

RANGING = {"length-scale": "0.01 to 5 percent"}
"""Usual sizes for distances measured by radio or pulses: no interferometer has such errors"""
