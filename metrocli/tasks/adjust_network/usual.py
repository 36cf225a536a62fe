"""Usual sizes of the errors of instruments: those of laser trackers, and larger ones beside a larger declared noise.

An instrument is built and adjusted as well as it reads: a circle that is read to arcseconds is not centred to a tenth.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.effects.effect import Effect
from metrocli.tasks.adjust_network.effects import EFFECTS
from metrocli.tasks.adjust_network.readings import NetworkReadings
from metrocli.tasks.adjust_network.settings import InstrumentNoise, NetworkInstrument

_TRACKER = {"angle": 2.5e-6, "length": 0.01, "ratio": 0.5e-6}
"""Noise of the trackers whose sizes the table has: of circles [rad], and of both parts of a distance [mm, 1]"""
_ACROSS = ("tracker-beam-offset", "tracker-transit-offset")
"""Effects whose length shows in angles"""
_OTHERS = (
    *("tracker-air-gradient", "given-point", "bar-error", "height-epoch", "station-height", "target-height"),
    *("tracer-scale", "dead-path-jump", "dead-path-drift"),
)
"""Effects that are as large whatever reads them, and those of interferometers, which have sizes of their own"""


def effects(readings: NetworkReadings) -> Iterator[Effect]:
    """Yield the table of effects with the usual sizes for the instruments of a network."""
    stations = range(len(readings.stations.names))
    of_stations = {readings.stations.names[i]: _declared(readings.of(i), _sigma(readings, [i])) for i in stations}
    of_instruments = {
        name: _declared(instrument, _sigma(readings, np.flatnonzero(readings.stations.instrument == number)))
        for number, (name, instrument) in enumerate(readings.instruments.items())
    }
    for effect in EFFECTS:
        noises = of_stations if effect.keys[:1] == ("station",) else of_instruments
        times = {name: _times(effect, noise) for name, noise in noises.items()}
        sizes = dict.fromkeys(times.values())
        if len(sizes) == 1 or effect.keys[:1] == ("point",):
            # all may read a point
            yield effect.larger(max(sizes))
            continue
        for size in sizes:
            yield replace(effect.larger(size), among=tuple(name for name in times if times[name] == size))


def of_instrument(effect: Effect, instrument: NetworkInstrument) -> Effect:
    """Return an effect with the usual sizes for an instrument."""
    return effect.larger(_times(effect, _declared(instrument, np.full(3, np.nan))))


def _sigma(readings: NetworkReadings, stations: Sequence[int] | Index) -> Array:
    """Return the median standard deviations (3,) in columns of what some stations read, nan without any."""
    seen = readings.sightings
    rows = seen.sigma[:, np.isin(seen.station, stations)]
    given = [row[np.isfinite(row)] for row in rows]
    return np.array([np.median(row) if row.size else np.nan for row in given])


def _declared(instrument: NetworkInstrument, sigma: Array) -> dict[str, float]:
    """Return the noise of an instrument, for which standard deviations of the readings stand where they are given."""
    noise = instrument.noise or InstrumentNoise()
    distance = noise.distance
    constant, proportional = (0.0, 0.0) if distance is None else (distance.constant, distance.proportional)
    columns = np.isfinite(sigma)
    circles = np.where(columns, sigma, [noise.azimuth, noise.elevation, 0.0])[:2]
    # a column has both parts of a distance as one
    length, ratio = (float(sigma[2]), 0.0) if columns[2] else (constant, proportional)
    return {"angle": float(circles.max()), "length": length, "ratio": ratio}


def _times(effect: Effect, declared: Mapping[str, float]) -> float:
    """Return how many times as large an effect usually is as with a tracker: as its noise, and at least once."""
    if effect.name in _OTHERS:
        return 1.0
    shows = effect.parameters[0].dimension.replace("speed", "length")
    kind = "angle" if effect.name in _ACROSS else shows
    return max(float(f"{declared[kind] / _TRACKER[kind]:.2g}"), 1.0) if kind in declared else 1.0
