"""Quantities on which effects of one's own, and laws, can act in the calibration of a machine."""

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
from metrocli.tasks.shared.length_effects import AT, BEAM, length

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
