"""The frame of a network without a list of points: its first station at the origin."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.geometry import poses
from metrocli.instruments import stations as s
from metrocli.instruments import tracer as t
from metrocli.tasks.adjust_network.problem import Network


def to_origin(network: Network, solution: Solution) -> Array:
    """Return the pose that brings the first station to the origin."""
    name = network.readings.stations.names[network.first]
    blocks = solution.blocks
    if s.STATION in blocks and name in blocks[s.STATION].members:
        # a turn would tilt the verticals of the levelled stations
        level = any(kind in blocks for kind in (s.LEVELLED, s.OVER))
        pose = blocks[s.STATION].row(name)
        if not level:
            return poses.inverse(pose)
        return np.concatenate([-pose[:3], np.zeros(3)])
    if t.TRACER in blocks and name in blocks[t.TRACER].members:
        return np.concatenate([-blocks[t.TRACER].row(name)[:3], np.zeros(3)])
    if s.LEVELLED in blocks and name in blocks[s.LEVELLED].members:
        place = blocks[s.LEVELLED].row(name)
    else:
        place = blocks[t.POINT].values[network.readings.stations.over[network.first]]
    round_ = next(i for i, (station, _) in enumerate(network.readings.sightings.rounds) if station == network.first)
    # a listed orientation has fixed the turn of the network already
    known = np.isfinite(network.readings.stations.gamma).any()
    gamma = 0.0 if known else float(blocks[s.ORIENTATION].values[round_, 0])
    return poses.inverse(np.array([*place, 0.0, 0.0, gamma]))


def moved(block: Block, move: Array) -> Block:
    """Return a block after a rigid motion of the network."""
    values = block.values.copy()
    if block.name in (t.POINT, s.LEVELLED, t.TRACER):
        values[:, :3] = poses.apply(move, values[:, :3])
    elif block.name == s.STATION:
        values = poses.compose(move, values)
    elif block.name == s.ORIENTATION:
        # listed orientations are fixed, and the network does not turn against them
        values = values + move[5] * block.free
    return block.with_values(values)
