"""Usual sizes of the errors of instruments: those of laser trackers, and larger ones beside a larger declared noise.

An instrument is built and adjusted as well as it reads: a circle that is read to arcseconds is not centred to a tenth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from metrocli.effects.effect import Effect
from metrocli.tasks.adjust_network.effects import EFFECTS
from metrocli.tasks.adjust_network.readings import NetworkReadings
from metrocli.tasks.adjust_network.settings import NetworkInstrument

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
    of_stations = {name: readings.of(number) for number, name in enumerate(readings.stations.names)}
    for effect in EFFECTS:
        instruments = of_stations if effect.keys[:1] == ("station",) else readings.instruments
        times = {name: _times(effect, instrument) for name, instrument in instruments.items()}
        sizes = dict.fromkeys(times.values())
        if len(sizes) == 1 or effect.keys[:1] == ("point",):
            # all may read a point
            yield effect.larger(max(sizes))
            continue
        for size in sizes:
            yield replace(effect.larger(size), among=tuple(name for name in times if times[name] == size))


def of_instrument(effect: Effect, instrument: NetworkInstrument) -> Effect:
    """Return an effect with the usual sizes for an instrument."""
    return effect.larger(_times(effect, instrument))


def _times(effect: Effect, instrument: NetworkInstrument) -> float:
    """Return how many times as large an effect usually is as with a tracker: as its noise, and at least once."""
    noise = instrument.noise
    if noise is None or effect.name in _OTHERS:
        return 1.0
    distance = noise.distance
    declared = {
        "angle": max(noise.azimuth, noise.elevation),
        "length": 0.0 if distance is None else distance.constant,
        "ratio": 0.0 if distance is None else distance.proportional,
    }
    shows = effect.parameters[0].dimension.replace("speed", "length")
    kind = "angle" if effect.name in _ACROSS else shows
    return max(float(f"{declared[kind] / _TRACKER[kind]:.2g}"), 1.0) if kind in declared else 1.0
