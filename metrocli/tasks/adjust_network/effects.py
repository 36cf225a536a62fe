"""Effects on the readings of a network."""

from __future__ import annotations

from dataclasses import replace

from metrocli.adjust.model.quantities import Quantity
from metrocli.effects.acting import Acting, components, point, seen_from
from metrocli.effects.effect import Effect, Parameter, change_points, sizes
from metrocli.effects.links.angles import Tilted, Turned
from metrocli.effects.links.points import Shift
from metrocli.effects.links.stations import (
    IN_ORDER,
    ExactListedWrongly,
    HeightStep,
    ListedWrongly,
    StationDrift,
    StationRaised,
    TargetRaised,
)
from metrocli.instruments.tracker import POLAR
from metrocli.tasks.shared.length_effects import LENGTH_EFFECTS, length
from metrocli.tasks.shared.tracker_effects import TRACKER_EFFECTS

_SOURCE = "Baarda 1968, A testing procedure for use in geodetic networks; deformation analysis"
_AT = (Parameter("at", "time", grid=change_points),)
_ACROSS_INSTRUMENTS = ("tracker-air-gradient",)
_OF_TRACERS = {"tracer-scale": "instrument", "dead-path-jump": "tracer", "dead-path-drift": "tracer"}
STEERING = "tracker-steering-mirror"
MOVED = "point-moved"
NO_TIMES = "the readings have no times (column t_s); name it with its `from_station` in `effects:` to estimate it"
NO_MIRROR = (
    "an instrument with its laser in the head has no steering mirror; the tilt of one looks like that of mirror and "
    "transit together: name it in `effects:` to estimate it"
)

_OF_PLACES: tuple[Effect, ...] = (
    Effect(
        "point-moved",
        "a point was knocked or its nest touched: from a time on it stands elsewhere",
        sizes("dx dy dz", "length", "1 mm"),
        lambda block, where: Shift(block, Quantity.POINT_IN_MACHINE, since="t"),
        where=("point",),
        by="t",
        scanned=_AT,
        needs=("t",),
        confused_with=("station-moved",),
        formula="x += (dx, dy, dz) for t >= at",
        usual="10 um to 1 mm",
        reveal="the point again from the first station",
        source=_SOURCE,
    ),
    Effect(
        "point-moved",
        "a point was knocked or its nest touched: from one station on it stands elsewhere",
        sizes("dx dy dz", "length", "1 mm"),
        lambda block, where: Shift(block, Quantity.POINT_IN_MACHINE, since=IN_ORDER),
        where=("point",),
        scanned=(Parameter("from_station", place="station"),),
        needs=(IN_ORDER,),
        confused_with=("station-moved",),
        formula="x += (dx, dy, dz) from the station from_station on, in the order of the list of stations",
        note="A job names it; `diagnose` does not seek it without times.",
        usual="10 um to 1 mm",
        reveal="the point again from the first station",
        source=_SOURCE,
    ),
    Effect(
        "station-moved",
        "a station was pushed during its measurement",
        sizes("dx dy dz", "length", "1 mm"),
        lambda block, where: Shift(block, Quantity.POINT_IN_MACHINE, sign=-1.0, since="t"),
        where=("station",),
        scanned=_AT,
        needs=("t",),
        confused_with=("station-tilted", "station-turned", "station-drift", "point-moved"),
        formula="S += (dx, dy, dz) for t >= at, along the axes of the network",
        usual="10 um to 1 mm",
        reveal="the first points again at the end of the station",
        source=_SOURCE,
    ),
    Effect(
        "station-tilted",
        "the stand of a station settled during its measurement: its standing axis leans otherwise",
        sizes("rx ry", "angle", "60 arcsec"),
        lambda block, where: Tilted(block),
        where=("station",),
        scanned=_AT,
        needs=("t",),
        confused_with=("station-moved",),
        formula="R <- R R(rx, ry, 0) for t >= at    # about the axes of the instrument",
        usual="1 to 60 arcsec",
        reveal="the first points again at the end of the station; the level of the instrument",
        source=_SOURCE,
    ),
    Effect(
        "station-turned",
        "a station turned about its standing axis during its measurement",
        sizes("rz", "angle", "60 arcsec"),
        lambda block, where: Turned(block),
        where=("station",),
        scanned=_AT,
        needs=("t",),
        confused_with=("station-moved",),
        formula="R <- R R(0, 0, rz) for t >= at",
        usual="1 to 60 arcsec",
        reveal="the first points again at the end of the station",
        source=_SOURCE,
    ),
    Effect(
        "station-drift",
        "a station moves slowly on its stand while it measures",
        sizes("vx vy vz", "speed", "1 um/min"),
        lambda block, where: StationDrift(block),
        where=("station",),
        needs=("t",),
        confused_with=("station-moved",),
        formula="S += (vx, vy, vz) (t - t0)    # t0: first time of the station; along the axes of the network",
        usual="1 to 60 um/h",
        reveal="the first points again at the end of the station, in three directions",
        source="Schwenke et al. 2008, CIRP Annals 57",
    ),
    Effect(
        "target-height",
        "the height of a target's set-up is wrong",
        sizes("dh", "length", "100 mm"),
        lambda block, where: TargetRaised(block),
        where=("setup",),
        not_first=("setup",),
        confused_with=("point-moved",),
        formula="the sightings aim at z + dh, along the vertical at the point",
        note="An unknown height of a set-up (an empty sigma) absorbs it.",
        usual="0.2 to 100 mm",
        reveal="the height measured again, or a second sighting of the target with another height",
        source=_SOURCE,
    ),
    Effect(
        "target-height",
        "the height of a target over one point is wrong at one station",
        sizes("dh", "length", "100 mm"),
        lambda block, where: TargetRaised(block),
        where=("point", "station"),
        confused_with=("point-moved",),
        formula="the sightings aim at z + dh, along the vertical at the point",
        usual="0.2 to 100 mm",
        reveal="the height measured again, or a second sighting of the target with another height",
        source=_SOURCE,
    ),
    Effect(
        "station-height",
        "the height of an instrument over its mark is wrong",
        sizes("dh", "length", "100 mm"),
        lambda block, where: StationRaised(block),
        where=("station",),
        confused_with=("station-moved",),
        formula="S += dh u    # u: vertical at the station",
        note="An unknown height (an empty sigma) absorbs it.",
        usual="0.2 to 100 mm",
        reveal="the height measured again, or a level line to the mark",
        source=_SOURCE,
    ),
    Effect(
        "bar-error",
        "the certificate of a bar, or the way it lies, is wrong",
        sizes("step", "length", "10 mm"),
        lambda block, where: Shift(block, Quantity.LENGTH),
        where=("bar",),
        confused_with=("point-moved",),
        formula="listed length += step",
        note="It is a cause, not a wrong reading.",
        usual="2 um to 10 mm",
        reveal="the bar in a second place, or another bar between the same points",
        source=_SOURCE,
    ),
    Effect(
        "given-point",
        "the listed coordinates of a given point are wrong, or its mark has moved since",
        sizes("dx dy dz", "length", "100 mm"),
        lambda block, where: ListedWrongly(block, where["point"]),
        where=("point",),
        needs=("list of {point}",),
        confused_with=("point-moved",),
        formula="x_listed += (dx, dy, dz)",
        note="A mark that has moved by d since it was listed has a list that is off by -d.",
        usual="10 um to 100 mm",
        reveal="a further given point near to it",
        source=_SOURCE,
        selects=True,
    ),
    Effect(
        "given-point",
        "the exact listed coordinates of a given point are wrong, or its mark has moved since",
        sizes("dx dy dz", "length", "100 mm"),
        lambda block, where: ExactListedWrongly(block, where["point"]),
        where=("point",),
        needs=("exact list of {point}",),
        confused_with=("point-moved",),
        formula="x = x_listed - (dx, dy, dz) for all that reads the point    # of its coordinates with sigma 0",
        usual="10 um to 100 mm",
        reveal="a further given point near to it",
        source=_SOURCE,
        selects=True,
    ),
    Effect(
        "height-epoch",
        "a mark stands higher in a later levelling than before: it moved, or its height was taken from another surface",
        sizes("dh", "length", "10 mm"),
        lambda block, where: HeightStep(block, where["point"], "t"),
        by="t",
        where=("point",),
        scanned=_AT,
        needs=("t", "heights of {point}"),
        formula="dh += s h for t >= at    # s: 1 for lines to the mark, -1 for lines from it; h: the parameter dh",
        note="The other lines may be wrong by the opposite instead.",
        usual="0.1 to 10 mm",
        reveal="the lines of the first levelling again",
        source=_SOURCE,
        selects=True,
    ),
    Effect(
        "height-epoch",
        "a mark stands higher in one levelling than in others: it moved, or its height was taken from another surface",
        sizes("dh", "length", "10 mm"),
        lambda block, where: HeightStep(block, where["point"], "method"),
        where=("point",),
        scanned=(Parameter("method", place="method"),),
        not_first=("method",),
        needs=("method", "heights of {point}"),
        formula="dh += s h for the lines of one method    # s: 1 for lines to the mark, -1 for lines from it; "
        "h: the parameter dh",
        usual="0.1 to 10 mm",
        reveal="the lines of the first levelling again",
        source=_SOURCE,
        selects=True,
    ),
)
"""Effects on points, stations, targets and what is listed"""

_ALL: tuple[Effect, ...] = (
    *(
        effect if effect.name in _ACROSS_INSTRUMENTS else replace(effect, where=("instrument",))
        for effect in TRACKER_EFFECTS
    ),
    *(replace(effect, where=(_OF_TRACERS[effect.name],)) for effect in LENGTH_EFFECTS if effect.name in _OF_TRACERS),
    *(replace(effect, limited=not effect.is_step) for effect in _OF_PLACES),
)
_NAMES = {effect.name for effect in _ALL}
EFFECTS = tuple(
    replace(effect, confused_with=tuple(name for name in effect.confused_with if name in _NAMES)) for effect in _ALL
)
"""The table of effects in the order of lists"""

_WHERE = ("instrument", "station", "point")
PLACES: tuple[Acting, ...] = (
    Acting(
        "sighting", Quantity.POLAR, ("rad", "rad", "mm"), POLAR, (*components(POLAR, ("rad", "rad", "mm")),), _WHERE
    ),
    point("point-in-tracker", Quantity.POINT_IN_TRACKER, _WHERE, *seen_from()),
    point("point-in-machine", Quantity.POINT_IN_MACHINE, _WHERE),
    length(),
)
"""Quantities on which user-defined effects can act"""
