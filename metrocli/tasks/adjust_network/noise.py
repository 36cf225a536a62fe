"""Standard deviations of the readings of a network at its adjusted geometry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.arrays import Array, Index
from metrocli.instruments import tracer as t
from metrocli.instruments.tracker import AZIMUTH, DISTANCE, ELEVATION, POLAR, PolarReading, ReadPolar
from metrocli.tasks.adjust_network.settings import NetworkInstrument

_PARTS = ("azimuth", "elevation", "lateral", "centring", "constant", "proportional")
GIVEN = tuple(f"sigma of {name}" for name in POLAR)
"""Conditions: standard deviations that the file gives, nan where the noise of the instrument holds"""
FACTOR = "noise factor"
"""Condition: how many times the declared noise a reading has"""
_FAR = 1e9
"""Distance at which an offset across changes no angle [mm]"""
_LEAST = 1e-6
"""Least cosine of an elevation in the noise of an azimuth"""


def parts_of(instruments: Mapping[str, NetworkInstrument], which: Index) -> dict[str, Array]:
    """Return the parts of the noise of the instrument of each reading, as conditions."""
    table = np.zeros((len(instruments), len(_PARTS)))
    for row, instrument in zip(table, instruments.values(), strict=True):
        noise = instrument.noise
        if noise is not None:
            row[:4] = noise.azimuth, noise.elevation, noise.lateral, noise.centring
            if noise.distance is not None:
                row[4:] = noise.distance.constant, noise.distance.proportional
    return {f"noise {name}": table[which, k] for k, name in enumerate(_PARTS)}


def of_sightings(group: Group, blocks: Mapping[str, Block]) -> Array:
    """Return the standard deviations of one component of sightings, (1, n)."""
    which, given = component(group), group.observations.conditions
    sigma = _sigma(which, ideal(group, blocks), [given[f"noise {name}"] for name in _PARTS])
    listed = given[GIVEN[which]]
    return np.asarray((np.where(np.isnan(listed), sigma, listed) * given.get(FACTOR, np.ones(1)))[None])


def ideal(group: Group, blocks: Mapping[str, Block]) -> Array:
    """Return azimuth, elevation and distance of sightings without errors of the instrument, (3, n)."""
    links = group.chain.links
    chain = Chain(links[: next(i for i, link in enumerate(links) if isinstance(link, PolarReading)) + 1])
    return chain.predict(blocks, group.observations)


def _sigma(which: int, seen: Array, parts: Sequence[Array]) -> Array:
    """Return the standard deviations by the parts of the noise, at azimuth, elevation and distance (3, n)."""
    azimuth, elevation, lateral, centring, constant, proportional = parts
    distance, across = seen[DISTANCE], lateral**2 + centring**2
    if which == AZIMUTH:
        # an azimuth scatters by the offset across over the level distance: near the vertical it has no direction left
        level = distance * np.maximum(np.cos(seen[ELEVATION]), _LEAST)
        return np.asarray(np.sqrt(azimuth**2 + across / level**2))
    if which == ELEVATION:
        return np.asarray(np.sqrt(elevation**2 + across / distance**2))
    return np.asarray(np.sqrt(constant**2 + (proportional * distance) ** 2 + centring**2))


def declared(instruments: Mapping[str, NetworkInstrument], which: Index, seen: Array, given: Array) -> Array:
    """Return the standard deviations that are declared for readings `seen` (3, n), or `given` in their file, (3, n).

    `which` are their instruments. Angles without a distance have the noise of far points, which is the least.
    """
    parts = list(parts_of(instruments, which).values())
    angles, distance = np.nan_to_num(seen[:DISTANCE]), np.where(np.isnan(seen[DISTANCE]), _FAR, seen[DISTANCE])
    at = np.vstack([angles, distance])
    return np.stack([np.where(np.isnan(given[k]), _sigma(k, at, parts), given[k]) for k in range(len(given))])


def component(group: Group) -> int:
    """Return which of azimuth, elevation and distance a group of sightings reads."""
    return next(link.component for link in group.chain.links if isinstance(link, ReadPolar))


def of_lengths(group: Group, blocks: Mapping[str, Block]) -> Array:
    """Return the standard deviations of lengths of interferometers, (1, n)."""
    observations = group.observations
    # the noise grows with the path, of which a relative length lacks the dead path
    path = observations.readings[0] + blocks[t.TRACER].values[observations.index[t.TRACER], 3]
    given = observations.conditions
    constant, proportional = given["noise constant"], given["noise proportional"]
    sigma = np.sqrt(constant**2 + (proportional * path) ** 2)
    return np.asarray((sigma * given.get(FACTOR, np.ones(1)))[None])
