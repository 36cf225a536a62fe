"""standstill: build the adjustment of points that a tracker or a network measured at commanded positions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import IDENTITY, Chain, Link, LinkContext, Step
from metrocli.adjust.model.groups import Group, prior
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array, Index
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.instruments.axes.error_motion import FAR_OFF, positions_block
from metrocli.instruments.axes.kinematics import reach
from metrocli.instruments.axes.rotary import gauge
from metrocli.instruments.machine import Machine
from metrocli.instruments.tracker import FACE, POLAR, TRACKER, cartesian, point_chain, tracker_block
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import commanded, error_blocks, machine_of, must_support
from metrocli.tasks.calibrate_machine.files import NO_FILES, Files
from metrocli.tasks.calibrate_machine.machine_settings import ESTIMATED
from metrocli.tasks.calibrate_machine.methods.targets import BED, targets, with_distances
from metrocli.tasks.calibrate_machine.methods.track import tracker_pose
from metrocli.tasks.calibrate_machine.problem import NETWORK, MachineProblem, conditions, model_of
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.shared.lists import matched, refuse
from metrocli.uncertainty.predicted import PredictedPlaces, points_of

READINGS = "points"
CARTESIAN = ("mx", "my", "mz")
_VAGUE = 10.0
"""Uncertainty of a tool vector of which nothing is known [mm], in the place of the tracker"""


def faces(points: Table) -> dict[str, Array]:
    """Return the face of each point, 1 or -1, if the file has it; raises InputError for others than 1 and 2."""
    if "face" not in points:
        return {}
    given = points.numbers("face")
    refuse(points, {"the face is 1 or 2": ~np.isin(given, (1.0, 2.0))})
    return {FACE: np.where(given == 1.0, 1.0, -1.0)}


def standstill(settings: Settings, points: Table, files: Files = NO_FILES) -> MachineProblem:
    """Return the adjustment problem; raises InputError if the measured points do not match the commanded ones."""
    machine = machine_of(settings)
    blocks = error_blocks(machine, settings)
    position = commanded(machine, points)
    poses = positions_of(settings, machine, position, points)
    reflectors = with_distances(targets(settings, blocks, points, files.reflectors), files.distances)
    measured, covariance, network = _measured(settings, points, files.network)
    if position.shape[1] < 4:
        raise InputError(
            [Fault(f"{position.shape[1]} points are too few to determine the pose of the tracker", points.file)]
        )
    must_support(machine, position, blocks)
    on = settings.instrument.on
    places = reflectors.places(machine, position, on)
    tried = machine.turns or len(settings.tools) > 1
    pose = tracker_pose(measured, places, points.file, tried, *([FAR_OFF] if poses.letters else []))
    observations = Observations(
        measured,
        np.ones(1),
        {**machine.index(position), **reflectors.index, **network.index, **poses.index},
        covariance=covariance,
        keys={"point": tuple(points.texts("point"))},
        conditions=conditions(machine, position, points, places if machine.turns else None)
        | faces(points)
        | (reflectors.conditions if machine.turns else {}),
        components=("x", "y", "z"),
        unit="mm",
    )
    chain = point_chain(reach(machine, on, reflectors.workpiece, poses.letters))
    readings = Group(READINGS, Chain((*chain.links, *network.links)), observations)
    unknowns = {**blocks, **reflectors.blocks, **network.blocks, **poses.blocks}
    unknowns[TRACKER] = tracker_block(pose, max(min(settings.machine.tool_std, _VAGUE), network.std))
    return MachineProblem(
        model_of(unknowns, readings, (*reflectors.others, *network.others, *gauge(machine, unknowns))),
        machine,
        np.ones(position.shape[1]),
        reflectors.used(list(settings.tools)),
        reflectors.read_once,
        sees_bed=machine.turns and on == BED,
    )


def _measured(settings: Settings, points: Table, network: Result | None) -> tuple[Array, Array, NetworkErrors]:
    """Return measured points (3, n) in the instrument's frame with their covariance, and what a network adds to it.

    They are those of a network, coordinates or polar readings. Raises InputError if the file has none of these.
    """
    if network is not None:
        return measured_in(network, points)
    both = [name for name in (*CARTESIAN, *POLAR) if name in points]
    if set(both) & set(CARTESIAN) and set(both) & set(POLAR):
        text = f"the file has measured coordinates and polar readings: {', '.join(both)}"
        raise InputError([points.fault(text, "keep mx, my and mz, or distance, azimuth and elevation")])
    if all(name in points for name in CARTESIAN):
        measured = points.stacked(CARTESIAN).T
    elif all(name in points for name in POLAR):
        measured = cartesian(points.stacked(POLAR).T)[0]
    else:
        missing = next(name for name in CARTESIAN if name not in points)
        hint = "measured places are mx_mm, my_mm, mz_mm, or distance_mm, azimuth_deg, elevation_deg"
        raise InputError([points.fault(f"the column '{missing}_mm' is missing", hint)])
    return measured, settings.noise.of_tracker.covariance(measured), NONE


@dataclass(frozen=True)
class PositionsOfAxes:
    """Unknown positions of rotary axes; empty where all are given."""

    blocks: Mapping[str, Block] = field(default_factory=dict)
    index: Mapping[str, Index] = field(default_factory=dict)
    letters: tuple[str, ...] = ()


def positions_of(settings: Settings, machine: Machine, position: Array, points: Table) -> PositionsOfAxes:
    """Return the positions (axes, n) that a job estimates: one for each position of an axis in each run.

    An axis that a run does not move has one position in it. Without a column run all rows are one run.
    """
    estimated = {letter for letter, axis in settings.machine.axes.turning.items() if axis.positions == ESTIMATED}
    runs = np.array(points.texts("run", ""))
    positions = PositionsOfAxes()
    for axis, own in zip(machine.axes, position, strict=True):
        if axis.letter in estimated:
            # nine digits: two positions that differ in the file must not become one
            named = zip(runs.tolist(), np.degrees(own).tolist(), strict=True)
            names = [f"{run} {at:.9g}".strip() for run, at in named]
            number = {name: i for i, name in enumerate(dict.fromkeys(names))}
            block = positions_block(axis.letter, list(number))
            index = {block.name: np.array([number[name] for name in names], dtype=np.intp)}
            positions = PositionsOfAxes(
                {**positions.blocks, block.name: block}, {**positions.index, **index}, (*positions.letters, axis.letter)
            )
    return positions


_SINGULAR = 1e-6
"""Share of the mean variance that no direction falls below: a free datum leaves six directions without any"""
_FAR = 10.0
"""Plausible size of independent errors of the size 1: they are known before any reading"""
_MOST = 1800
"""Most errors that points have in common: each is an unknown of all readings"""
_POINT = "point of the network"
"""Index of the point of each reading"""


@dataclass(frozen=True)
class NetworkErrors:
    """Unknown errors of the points of a network, which have its joint covariance; empty for other points."""

    blocks: Mapping[str, Block] = field(default_factory=dict)
    index: Mapping[str, Index] = field(default_factory=dict)
    links: tuple[Link, ...] = ()
    others: tuple[Group, ...] = ()
    std: float = 0.0
    """Largest standard uncertainty of a coordinate [mm]"""


NONE = NetworkErrors()


@dataclass(frozen=True)
class JointErrors(OfBlock):
    """Link `X += L_i z`: errors of points with the covariance `L L'`, z independent errors of the size 1."""

    root: Array
    """L, (points, 3, k)"""
    # effects act before: one that stretched these errors too would make them small
    takes, gives = Quantity.POINT_IN_TRACKER, Quantity.POINT_IN_NETWORK

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the points (3, n), with their derivatives L by z, (3, k, n)."""
        own = np.moveaxis(self.root[local.observations.index[_POINT]], 0, -1)
        return Step(value + np.einsum("akn,k->an", own, local.members(self.block)[0]), IDENTITY, {self.block: own})


def measured_in(network: Result, points: Table) -> tuple[Array, Array, NetworkErrors]:
    """Return the places (3, n) of points in the frame of their network, a covariance (3, 3, n), and their errors.

    The joint covariance is that of the points' own errors with `L L'` of those in common. Together they are a
    generalised adjustment, in which each point keeps its own test. Raises InputError for a point that the network does
    not have, and for more common errors than fit into one table.
    """
    names = network.tables["points"].texts("point")
    places = points_of(network).of(matched(points, "point", names, "the points of the network"))
    own, root = _split(places, points)
    n, _, count = root.shape
    columns = tuple(f"z{j + 1}" for j in range(count))
    block = Block(NETWORK, np.zeros((1, count)), columns, reach=np.array(_FAR))
    known = prior(block, np.zeros(1, dtype=np.intp), np.ones((1, count)))
    std = float(np.sqrt(np.einsum("naa->na", places.covariance).max()))
    errors = NetworkErrors({NETWORK: block}, {_POINT: np.arange(n)}, (JointErrors(NETWORK, root),), (known,), std)
    return places.values.T, np.moveaxis(own, 0, -1), errors


def _split(places: PredictedPlaces, points: Table) -> tuple[Array, Array]:
    """Return the covariance of the points' own errors (n, 3, 3), and the root L (n, 3, k) of that in common.

    Of points that a network has without errors of their own, these are half of the least variance in any direction.
    """
    n, own = len(places.values), places.own
    least = _SINGULAR * float(np.einsum("naa->", places.covariance)) / (3 * n)
    apart = len(places.core) < 3 * n and bool((np.linalg.eigvalsh(own)[:, 0] > least).all())
    count = len(places.core) if apart else 3 * n
    if count > _MOST:
        text = f"the {n} points have {count} errors in common, more than the {_MOST} that are estimated together"
        raise InputError([points.fault(text, f"list at most {_MOST // 3} points of this network")])
    if apart:
        values, vectors = np.linalg.eigh(places.core)
        return own, places.common @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    flat = places.common.reshape(3 * n, -1)
    joint = (flat @ places.core @ flat.T).reshape(n, 3, n, 3)
    joint[np.arange(n), :, np.arange(n)] += own
    values, vectors = np.linalg.eigh(joint.reshape(3 * n, 3 * n))
    values = np.maximum(values, least)
    half = values[0] / 2
    return np.broadcast_to(half * np.eye(3), own.shape), (vectors * np.sqrt(values - half)).reshape(n, 3, 3 * n)
