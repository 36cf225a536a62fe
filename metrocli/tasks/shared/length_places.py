"""Quantities of lengths of tracking interferometers on which effects of one's own, and laws, can act."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Local, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.acting import Acting, Variable, beam_from, scalar, seen_from
from metrocli.instruments.tracer import COS_A, INCIDENCE, SIN_A, TRACER

AT = ("tracer", "point")
"""Kinds of place at which an effect on lengths can have sizes of its own"""


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


DIRECTION = (Variable("azimuth", "rad", _azimuth), Variable("elevation", "rad", _elevation))
"""Constants within an adjustment: otherwise an effect would fix the orientation of a free network"""
BEAM = (*beam_from(TRACER), *seen_from(TRACER, ("distance",)))
"""Vector from the tracer to the point, and its length"""


def length(*more: Variable) -> Acting:
    """Return the length as a place to act: itself, time, temperature, nominal coordinates, its beam, and more."""
    path = Variable("distance", "mm", _path, (TRACER,))
    return scalar("length", Quantity.LENGTH, "mm", AT, path, *DIRECTION, *more)
