"""The datum of a network: the motions that nothing determines, and the points on which inner constraints lay it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.movements import Affine, of_members, of_points
from metrocli.arrays import Mask
from metrocli.instruments import stations as s
from metrocli.instruments import tracer as t
from metrocli.instruments.tracker import DISTANCE
from metrocli.tasks.adjust_network.readings import NetworkReadings
from metrocli.tasks.adjust_network.settings import GIVEN, Settings
from metrocli.tasks.adjust_network.unknowns import kind_of_stations, seen_points

FREEDOMS = (*t.FREEDOMS, "scale")


def movements() -> dict[str, Affine]:
    """Return how shifts, turns and the scale of a network change each of its blocks."""
    places = of_points(scale=True)
    turned, raised = np.zeros((7, 1)), np.zeros((7, 1, 1))
    turned[5] = raised[6] = 1.0
    offsets = np.zeros((7, 3, 3))
    offsets[6] = np.eye(3)
    lengths = of_members(5, places)
    lengths.matrix[6, 3, 3] = 1.0
    return {
        t.POINT: places,
        s.STATION: of_members(6, places, slice(3, 6)),
        s.LEVELLED: of_members(3, places),
        s.OVER: Affine(offsets, np.zeros((7, 3))),
        t.TRACER: lengths,
        s.ORIENTATION: Affine(np.zeros((7, 1, 1)), turned),
        s.SETUP: Affine(raised, np.zeros((7, 1))),
    }


def datum_of(settings: Settings, readings: NetworkReadings, blocks: Mapping[str, Block]) -> tuple[int, Datum | None]:
    """Return the station at the origin, -1 if the frame is given, and the datum; None where given points fix all."""
    points = readings.points
    if settings.datum == GIVEN or (settings.datum is None and not open_by_given(readings)):
        return -1, None
    listed: Mask = np.asarray(np.isfinite(points.listed).all(axis=1))
    if settings.datum_points is not None:
        members = np.asarray(np.isin(np.array(points.names), settings.datum_points))
    else:
        members = listed if listed.any() else np.ones(points.count, dtype=bool)
    block = blocks[t.POINT]
    reference = np.where(np.isfinite(points.listed), points.listed, block.values)
    open_ones = _not_determined(readings)
    chosen = np.eye(len(FREEDOMS))[:, open_ones]
    used = {name: move.mixed(chosen) for name, move in movements().items() if name in blocks}
    taking = (members & block.free.all(axis=1)).astype(float)
    datum = Datum(t.POINT, np.nan_to_num(reference), taking, used, tuple(FREEDOMS[i] for i in open_ones))
    first = -1 if listed.any() else int(np.argmax([kind != "" for kind in kind_of_stations(readings)]))
    return first, datum


def _not_determined(readings: NetworkReadings) -> list[int]:
    """Return the numbers of the freedoms that no levelled or oriented station and no length determines.

    The reduced system of a single station does not tell the scale, or the turns of its vertical, from a shift.
    """
    stations = np.unique(readings.sightings.station)
    level = any(readings.of(i).is_levelled for i in stations)
    oriented = np.isfinite(readings.stations.gamma[stations]).any()
    lengths = readings.lengths is not None or readings.bars is not None
    lengths = lengths or bool(np.isfinite(readings.sightings.values[DISTANCE]).any())
    return [0, 1, 2, *([] if level else [3, 4]), *([] if oriented else [5]), *([] if lengths else [6])]


def open_by_given(readings: NetworkReadings) -> list[str]:
    """Return the motions that given points, verticals and lengths leave open."""
    points = readings.points
    used = np.isfinite(points.sigma) & seen_points(readings)[:, None]
    # levelled height differences show the direction of the vertical: tilts are no motions then
    needed = [i for i in _not_determined(readings) if i not in (3, 4) or readings.heights is None]
    place = np.nan_to_num(points.listed)
    centred = place - place[used.any(axis=1)].mean(axis=0) if used.any() else place
    # about their middle and of size 1: shifts and turns are then alike in size
    centred /= float(np.abs(centred[used.any(axis=1)]).max(initial=0.0)) or 1.0
    moves = of_points(scale=True).at(centred, np.arange(points.count))[used][:, needed]
    if not len(moves):
        return [FREEDOMS[i] for i in needed]
    _, values, vectors = np.linalg.svd(moves, full_matrices=True)
    values = np.concatenate([values, np.zeros(len(needed) - len(values))]) if len(values) < len(needed) else values
    loose = vectors[values < 1e-6 * values[0]]
    return [FREEDOMS[i] for k, i in enumerate(needed) if (np.abs(loose[:, k]) > 0.1).any()]
