"""A small measurement of each kind of job with effects, for the laws that every effect obeys.

To bring a kind under the laws, add a function that returns its model at the truth, with conditions in it and its places
named, to `MEASURED`. It is asked for each effect, since some are seen only in a measurement of their own sort.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import simulated_lengths
from effects_of_images import alignment, calibration

from metrocli.effects.effect import Effect
from metrocli.effects.model import Model, with_conditions
from metrocli.tasks.length_network import build


@dataclass(frozen=True)
class Measured:
    """A small measurement of one kind."""

    model: Callable[[Effect], Model]
    """At the truth, without noise; one in which this effect can be seen"""
    scanned: Mapping[str, float]
    """Values for scanned parameters, by name"""


def multilaterate(effect: Effect) -> Model:
    """25 points and five tracers, all known to 1 um; times and temperatures at random; absolute for a length offset."""
    net = simulated_lengths.network(25, 5, noise=0.0)
    rng = np.random.default_rng(4)
    if effect.name == "length-offset":
        net = replace(net, dead=np.zeros(5), readings=net.readings + net.dead)
    lengths = net.lengths()
    t = rng.uniform(100.0, 2000.0, len(lengths))
    temp = 20 + rng.uniform(0, 1, len(lengths))
    table = replace(lengths, columns={**lengths.columns, "t": t, "temp": temp})
    points = replace(net, nominal=net.points).point_table(sigma=np.full(25, 0.001))
    measures = "absolute" if effect.name == "length-offset" else "changes"
    tracers = net.tracer_table(0.0, sigma=np.full(5, 0.001))
    network = build(simulated_lengths.settings(measures=measures), table, points, tracers, None)
    model = network.model()
    true = np.column_stack([net.tracers, net.dead, net.scale])
    return with_conditions(model.with_blocks({**model.blocks, "tracer": model.blocks["tracer"].with_values(true)}))


MEASURED: dict[str, Measured] = {
    "calibrate-camera": Measured(lambda effect: with_conditions(calibration(effect)), {}),
    "align-part": Measured(lambda effect: with_conditions(alignment(effect)), {}),
    "multilaterate": Measured(multilaterate, {"at": 900.0}),
}


def instance_of(model: Model, effect: Effect) -> tuple[str, ...]:
    """A place where the effect can act: the second of each kind."""
    return tuple(model.places[key].names[1] for key in effect.where if key != "by")


def size(effect: Effect) -> dict[str, float]:
    """A plausible size of each parameter, different for each."""
    return {p.name: p.plausible * (0.7 - 0.4 * at) for at, p in enumerate(effect.parameters)}
