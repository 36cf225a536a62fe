"""Measurements without noise into which an effect of a given size can be put, one for each kind of job."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.hidden import grids, images, launch, lengths, machine
from benchmarks.hidden.scenes import board_scene, cmm_scene, part_scene
from metrocli.diagnosis.adjusted_job import AdjustedJob

Rng = np.random.Generator
Where = Mapping[str, str]
Values = Mapping[str, float]


@dataclass(frozen=True)
class Planted:
    """An effect at a place with its sizes."""

    name: str
    where: Where
    values: Values


Read = Callable[[Planted | None, Rng | None], AdjustedJob]
"""Returns the adjusted job of the readings with an effect or without, with noise drawn from a generator or without"""


def of_lengths(rng: Rng, name: str) -> Read:
    """A small network of tracers."""
    m = lengths.measurement(rng, 30)

    def read(planted: Planted | None, rng: Rng | None) -> AdjustedJob:
        length = m.distance
        if planted is not None:
            at = int(planted.where.get("tracer", "T0")[1:])
            values = {"by": float(planted.where.get("by") == "T"), **planted.values}
            length = length + lengths.signature(planted.name, at, values)(m)
        noise = 0.0 if rng is None else rng.normal(size=len(length)) * m.sigma
        return replace(m, length=length + noise).adjusted()

    return read


def of_images(kind: str) -> Callable[[Rng, str], Read]:
    """A board or places of a measuring machine before a camera, or a part before a camera in a spindle."""

    def subject(rng: Rng, name: str) -> Read:
        drawn = images.PLANTS[kind][name]
        if kind == "align-part":
            scene = part_scene(rng, 16, 8)
        else:
            rigs = [rig for rig in drawn.rigs if rig]
            scene = board_scene(rng, 8, (6, 5)) if rng.choice(rigs) == "board" else cmm_scene(rng, 40)
        scene = images.without(scene, [drawn], [name])

        def read(planted: Planted | None, rng: Rng | None) -> AdjustedJob:
            effects: dict[str, Any] = {}
            if planted is not None:
                plant = _plant(kind, planted)
                # a family can have more terms than the plant, such as k3 beside k2
                terms = {p: plant.parameters.get(p, p) for p in planted.values}
                place = "".join(v for k, v in planted.where.items() if k != "by")
                effects = images.effects_of(replace(plant, parameters=terms), planted.values, place)
            uv = scene.predicted(scene.start(), effects)
            noise = 0.0 if rng is None else rng.normal(0, scene.noise, uv.shape)
            return images.Images(scene, uv + noise).adjusted()

        return read

    return subject


def _plant(kind: str, planted: Planted) -> images.Plant:
    """Return how an effect is put into images, by time or by temperature."""
    by = planted.where.get("by", "")
    return next(p for n, p in images.PLANTS[kind].items() if (n.partition(",")[0], p.by) == (planted.name, by))


def of_launch_units(rng: Rng, name: str) -> Read:
    """Aligned poses of a launch unit, with distances where the effect is one of them."""
    m = launch.measurement(rng, name.startswith("distance") or bool(rng.integers(2)))

    def read(planted: Planted | None, rng: Rng | None) -> AdjustedJob:
        readings = m.predicted()
        if planted is not None:
            readings = readings + launch.change(m, planted.name, planted.where, planted.values)
        noise = 0.0 if rng is None else rng.normal(size=readings.shape) * m.sigma
        return replace(m, read=readings + noise).adjusted()

    return read


def of_grids(rng: Rng, name: str) -> Read:
    """Six views of a small grid."""
    m = grids.measurement(rng, "123456", grids.SMALL, noise=0.0)

    def read(planted: Planted | None, rng: Rng | None) -> AdjustedJob:
        readings = m.readings
        if planted is not None:
            readings = readings + grids.change(m, planted.name, _numbered(m, planted))
        noise = 0.0 if rng is None else rng.normal(0, grids.NOISE, readings.shape)
        return replace(m, readings=readings + noise).adjusted()

    return read


def _numbered(m: grids.Measurement, planted: Planted) -> dict[str, float]:
    """Return the sizes with the numbers of view, axis and ball."""
    view, axis = planted.where.get("view", "1"), planted.where.get("axis", "x")
    found = {"view": float(m.views.names.index(view)), "axis": float("xyz".index(axis)), **planted.values}
    if "ball" in planted.where:
        indices = [int(word) for word in planted.where["ball"].split()]
        found["ball"] = float(m.views.balls.tolist().index(indices))
    return found


def of_machines(rng: Rng, name: str) -> Read:
    """A small machine seen by a tracker."""
    m = machine.measurement(rng, machine.SMALL, noise=0.0)

    def read(planted: Planted | None, rng: Rng | None) -> AdjustedJob:
        found = m
        if planted is not None:
            found = replace(m, read=m.read + machine.change(m, planted.name, planted.where, planted.values))
        return (found if rng is None else machine.noisy(found, rng)).adjusted()

    return read


@dataclass(frozen=True)
class Kind:
    """How measurements of a kind are made, and the effects that can be put into them."""

    subject: Callable[[Rng, str], Read]
    effects: tuple[str, ...]


KINDS = {
    "multilaterate": Kind(of_lengths, (*lengths.EVERYWHERE, *lengths.AT_ONE)),
    "align-part": Kind(of_images("align-part"), tuple(images.PLANTS["align-part"])),
    "calibrate-camera": Kind(
        of_images("calibrate-camera"), tuple(n for n in images.PLANTS["calibrate-camera"] if "," not in n)
    ),
    "locate-launch-unit": Kind(of_launch_units, tuple(launch.PARAMETERS)),
    "selfcal-grid": Kind(of_grids, grids.NAMES),
    "calibrate-machine": Kind(of_machines, tuple(machine.PARAMETERS)),
}
