"""Effects on the lengths of a network (docs/effects)."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.acting import Variable, beam_from, point, scalar, seen_from
from metrocli.instruments.tracer import COS_A, INCIDENCE, SIN_A, TRACER
from metrocli.tasks.shared.length_effects import LENGTH_EFFECTS

EFFECTS = LENGTH_EFFECTS
"""The table of effects, in the order of docs/effects"""

_TRACER = ("tracer", "point")


def _path(value: Array, local: Local) -> Step:
    """Return the geometric distance `|x - x0| = (l + l0) / s` from the length l (1, n), with its derivatives."""
    tracer = local.rows(TRACER)
    dead_path, scale = tracer[3], tracer[4]
    path = (value[0] + dead_path) / scale
    by_tracer = np.zeros((1, len(tracer), len(path)))
    by_tracer[0, 3], by_tracer[0, 4] = 1 / scale, -path / scale
    return Step(path[None], np.broadcast_to(1 / scale, path.shape)[None, None], {TRACER: by_tracer})


def _azimuth(value: Array, local: Local) -> Step:
    given = local.observations.conditions
    return Step(np.arctan2(given[SIN_A], given[COS_A])[None])


def _elevation(value: Array, local: Local) -> Step:
    return Step(np.arcsin(local.observations.conditions[INCIDENCE] - 1)[None])


_DIRECTION = (Variable("azimuth", "rad", _azimuth), Variable("elevation", "rad", _elevation))
"""Constants within an adjustment: otherwise an effect would fix the orientation of a free network"""
PLACES = (
    scalar("length", Quantity.LENGTH, "mm", _TRACER, Variable("distance", "mm", _path, (TRACER,)), *_DIRECTION),
    point(
        "point-in-machine",
        Quantity.POINT_IN_MACHINE,
        _TRACER,
        *beam_from(TRACER),
        *seen_from(TRACER, ("distance",)),
        *_DIRECTION,
    ),
)
"""Quantities on which effects of one's own can act"""

RANGING = {"length-scale": "0.01 to 5 percent"}
"""Usual sizes for distances measured by radio or pulses: no interferometer has such errors"""
