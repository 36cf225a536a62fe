"""Planning an on-the-fly measurement: what a path will determine, and a path that determines the volume."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from metrocli.adjust.blocks import Array, Block
from metrocli.adjust.groups import Group
from metrocli.adjust.observations import Observations
from metrocli.geometry import poses
from metrocli.instruments.machine import TOOL, Machine
from metrocli.instruments.machine_path import Path
from metrocli.instruments.tracker import LEG, TRACKER, TrackerNoise, leg_block, path_chain, tracker_block
from metrocli.tasks.machine_on_the_fly import READINGS
from metrocli.tasks.machine_problem import Problem, conditions, error_blocks, machine_of, tool_prior
from metrocli.tasks.machine_settings import PathPlan, Settings
from metrocli.tasks.machine_standstill import tracker_noise

_GAUSS = np.sqrt(0.6)
_NODES, _WEIGHTS = np.array([-_GAUSS, 0.0, _GAUSS]) / 2 + 0.5, np.array([5.0, 8.0, 5.0]) / 18.0


def planned_problem(settings: Settings, plan: PathPlan, path: Path) -> Problem:
    """Return the adjustment that a path will give, with its readings as the nodes of the cells."""
    machine = machine_of(settings)
    pose = _tracker_pose(machine, plan)
    rotation = poses.rotation_of(pose)
    blocks: dict[str, Block] = {
        **error_blocks(machine, settings),
        TRACKER: tracker_block(pose),
        LEG: leg_block(path.across @ rotation),
    }
    leg, along, length = _nodes(machine, path, settings.corner)
    position = path.at(leg, along)
    seen = poses.apply(poses.inverse(pose), (position + blocks[TOOL].values[path.tool[leg]].T).T).T
    across = blocks[LEG].values[leg].reshape(-1, 2, 3)
    points = length / (plan.feed * plan.sampling)
    covariance = np.einsum("nab,bcn,ndc->adn", across, tracker_noise(settings).covariance(seen), across) / points
    observations = Observations(
        np.zeros((2, len(leg))),
        np.ones(1),
        machine.index(position) | {TOOL: path.tool[leg], LEG: leg},
        covariance=covariance,
        conditions=conditions(position),
        components=("a", "b"),
        unit="mm",
    )
    names = list(settings.tools)
    used = tuple(names[i] for i in np.unique(path.tool))
    group = Group(READINGS, path_chain(machine), observations)
    return Problem(machine, blocks, group, tool_prior(blocks, settings), length, used)


def _tracker_pose(machine: Machine, plan: PathPlan) -> Array:
    """Return the tracker where it stands, or two thirds of the volume's size beside it."""
    size = machine.high - machine.low
    place = machine.low - np.array([1.5, 1.2, -0.5]) * size.max() if plan.tracker is None else np.array(plan.tracker)
    return np.concatenate([place, np.zeros(3)])


def _nodes(machine: Machine, path: Path, corner: float) -> tuple[Array, Array, Array]:
    """Return leg, way along it and length of path of the three Gauss nodes of every cell, corners cut."""
    low, high = path.cells(machine)[:-1], path.cells(machine)[1:]
    leg = path.leg_of((low + high) / 2)
    begin, end = low - path.before[leg], high - path.before[leg]
    begin, end = np.maximum(begin, corner), np.minimum(end, path.lengths[leg] - corner)
    keep = end - begin > 1e-3
    leg, begin, end = leg[keep], begin[keep], end[keep]
    size = (end - begin)[:, None]
    return np.repeat(leg, 3), (begin[:, None] + size * _NODES).ravel(), (size * _WEIGHTS).ravel()
