"""standstill: build the adjustment of points that the tracker measured at commanded positions."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array
from metrocli.errors import Fault, InputError
from metrocli.instruments.machine import TOOL
from metrocli.instruments.tracker import FACE, TrackerNoise, point_chain, tracker_block
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.methods.track import tracker_pose
from metrocli.tasks.calibrate_machine.problem import (
    Problem,
    commanded,
    conditions,
    error_blocks,
    machine_of,
    model_of,
    must_support,
    tool_prior,
    tools_of,
)
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.shared.lists import refuse

READINGS = "points"


def tracker_noise(settings: Settings) -> TrackerNoise:
    """Return the noise of the tracker."""
    noise = settings.noise
    return TrackerNoise(noise.beam or 0.0, noise.square.constant, noise.square.proportional)


def faces(points: Table) -> dict[str, Array]:
    """Return the face of each point, 1 or -1, if the file has it; raises InputError for others than 1 and 2."""
    if "face" not in points:
        return {}
    given = points.numbers("face")
    refuse(points, {"the face is 1 or 2": ~np.isin(given, (1.0, 2.0))})
    return {FACE: np.where(given == 1.0, 1.0, -1.0)}


def standstill(settings: Settings, points: Table) -> Problem:
    """Return the adjustment problem; raises InputError if the measured points do not match the commanded ones."""
    machine = machine_of(settings)
    blocks = error_blocks(machine, settings)
    tool = tools_of(points, settings)
    position = commanded(machine, points)
    measured = points.stacked(("mx", "my", "mz")).T
    if position.shape[1] < 4:
        raise InputError(
            [Fault(f"{position.shape[1]} points are too few to determine the pose of the tracker", points.file)]
        )
    must_support(machine, position, blocks)
    pose = tracker_pose(measured, position + blocks[TOOL].values[tool].T, points.file)
    observations = Observations(
        measured,
        np.ones(1),
        machine.index(position) | {TOOL: tool},
        covariance=tracker_noise(settings).covariance(measured),
        keys={"point": tuple(points.texts("point"))},
        conditions=conditions(position, points) | faces(points),
        components=("x", "y", "z"),
        unit="mm",
    )
    readings = Group(READINGS, point_chain(machine), observations)
    names = list(settings.tools)
    tracked = {**blocks, "tracker": tracker_block(pose, settings.machine.tool_uncertainty)}
    return Problem(
        model_of(tracked, readings, tool_prior(blocks, settings)),
        machine,
        np.ones(position.shape[1]),
        tuple(names[i] for i in np.unique(tool)),
    )
