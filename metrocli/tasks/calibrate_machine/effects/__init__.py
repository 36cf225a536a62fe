"""Effects that may disturb the calibration of a machine, and where those of one's own can act."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.acting import (
    MM,
    PLACE,
    TIMED,
    XYZ,
    Acting,
    OfPlace,
    commanded,
    components,
    condition,
    of_pair,
    point,
    seen_from,
)
from metrocli.effects.effect import Effect
from metrocli.tasks.calibrate_machine.effects.machine import OF_THE_MACHINE
from metrocli.tasks.calibrate_machine.effects.tracker import OF_THE_LASER, OF_THE_TRACKER
from metrocli.tasks.calibrate_machine.effects.turning import OF_ROTARY_AXES
from metrocli.tasks.shared.length_effects import AT, BEAM, LENGTH_EFFECTS, length

OF_MACHINES: tuple[Effect, ...] = (*OF_THE_MACHINE, *OF_ROTARY_AXES, *OF_THE_TRACKER)
"""Effects on machine and tracker. A single tracker cannot separate machine-drift and tracker-drift."""
OF_LINES = (*OF_MACHINES, *OF_THE_LASER)
"""For lines: with effects on the laser; those on a tracker are listed as not seen"""
OF_LENGTHS = (*OF_THE_MACHINE, *OF_ROTARY_AXES, *LENGTH_EFFECTS)
"""Effects on the machine and on lengths"""
OF_BALLS = (*OF_THE_MACHINE, *OF_ROTARY_AXES)
"""Effects on the machine and on balls that it probes"""
EFFECTS = (*OF_LINES, *LENGTH_EFFECTS)
"""All effects in the order of lists; each method has those that act on what it reads"""

__all__ = ["EFFECTS", "OF_BALLS", "OF_LENGTHS", "OF_LINES", "OF_MACHINES", "PLACES"]


_PLACES = ("axis", "pair")
_OF_PLACE: Mapping[str, OfPlace] = {"axis": commanded, "pair": of_pair}
_MOTION = (*XYZ, "rx", "ry", "rz")
_APPROACH = tuple(condition(f"from_{axis}", "1", f"from_{axis}") for axis in XYZ)
PLACES = (
    Acting(
        "error-motion",
        Quantity.ERROR_MOTION,
        (*MM, *["rad"] * 3),
        _MOTION,
        (*components(_MOTION, (*MM, *["rad"] * 3)), *TIMED[:1], *PLACE, *_APPROACH),
        _PLACES,
        _OF_PLACE,
    ),
    replace(
        point("point-in-machine", Quantity.POINT_IN_MACHINE, (*_PLACES, *AT), *BEAM, *_APPROACH), of_place=_OF_PLACE
    ),
    length(*_APPROACH),
    point("point-in-tracker", Quantity.POINT_IN_TRACKER, (), *seen_from(), *_APPROACH),
    point("coordinates", Quantity.POINT_IN_TRACKER, (), *seen_from(), *_APPROACH),
    Acting("across-leg", Quantity.ACROSS_LEG, MM[:2], ("first", "second"), (*TIMED[:1], *PLACE)),
)
"""Quantities on which effects of one's own can act; rx, ry, rz are rotations about the axes"""
