"""What the readings of a machine see: tools and reflectors at its spindle, reflectors and balls on its workpiece."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group, priors
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array, Index, Mask
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.instruments.axes.kinematics import (
    OF_TOOL,
    OF_WORKPIECE,
    ON_WORKPIECE,
    nominal_tip,
    seen_from_bed,
)
from metrocli.instruments.frames import DistanceBetween
from metrocli.instruments.machine import TOOL, Machine
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import tool_prior
from metrocli.tasks.calibrate_machine.problem import tools_of
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.shared.lists import matched, refuse, sigmas
from metrocli.words import listed, suggestion

BED, WORKPIECE = "bed", "workpiece"
_REACH = 100.0
"""Plausible error of a listed place [mm]"""


@dataclass(frozen=True)
class MeasuredTargets:
    """The targets of readings: members of the blocks of tools and of points on the workpiece."""

    blocks: Mapping[str, Block]
    """Tools, and points on the workpiece if there are any"""
    tool: Index
    """(n,)"""
    fixed: Index
    """Number of the point on the workpiece, (n,); 0 for a reading at the tool"""
    on_workpiece: Mask
    """(n,)"""
    others: tuple[Group, ...] = ()
    """Priors of listed places, and calibrated distances"""

    @property
    def workpiece(self) -> bool:
        """Whether points on the workpiece have unknowns of their own."""
        return ON_WORKPIECE in self.blocks

    @property
    def index(self) -> dict[str, Index]:
        """The members that readings use."""
        return {TOOL: self.tool, **({ON_WORKPIECE: self.fixed} if self.workpiece else {})}

    @property
    def conditions(self) -> dict[str, Array]:
        """The shares of workpiece and tool in the point that is read."""
        share = self.on_workpiece.astype(float)
        return {OF_WORKPIECE: share, OF_TOOL: 1 - share}

    @property
    def read_once(self) -> tuple[str, ...]:
        """A warning of points on the workpiece that have one reading, where nothing else is known of their places."""
        if not self.workpiece or any(ON_WORKPIECE in group.chain.blocks for group in self.others):
            return ()
        block = self.blocks[ON_WORKPIECE]
        counts = np.bincount(self.fixed[self.on_workpiece], minlength=len(block.members))
        names = [block.members[i] for i in np.flatnonzero(counts == 1)]
        if not names:
            return ()
        statement = f"{listed(names)} {'has one reading each' if names[1:] else 'has one reading'}"
        return (f"{statement}: it gives the place of the {block.noun}, and nothing of the machine",)

    def used(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the tools that have readings; the first one where only points on the workpiece are read."""
        at_tool = np.unique(self.tool[~self.on_workpiece])
        return tuple(names[i] for i in at_tool if i < len(names)) or (names[0],)

    def places(self, machine: Machine, position: Array, seen_from: str) -> Array:
        """Return the nominal places of the targets (3, n), in the axes of the body the instrument stands on."""
        vector = self.blocks[TOOL].values[self.tool].T
        if not machine.turns:
            return np.asarray(position + vector)
        if seen_from == WORKPIECE:
            return nominal_tip(machine, position, vector)[0]
        at_tool = seen_from_bed(machine, position, vector, True)
        if not self.workpiece:
            return at_tool
        fixed = seen_from_bed(machine, position, self.blocks[ON_WORKPIECE].values[self.fixed].T, False)
        return np.where(self.on_workpiece, fixed, at_tool)


def targets(settings: Settings, blocks: Mapping[str, Block], table: Table, reflectors: Table | None) -> MeasuredTargets:
    """Return the targets of a table whose column `tool` names tools and reflectors.

    Raises InputError for a name that is neither, and for a reflector on the workpiece that is seen from there.
    """
    if reflectors is None:
        tool = tools_of(table, settings)
        none = np.zeros(len(tool), dtype=np.intp)
        return MeasuredTargets({TOOL: blocks[TOOL]}, tool, none, none > 0, tool_prior(blocks, settings))
    names, listed = list(settings.tools), reflectors.texts("reflector")
    where = np.array(reflectors.texts("on"))
    refuse(reflectors, {"`on` is workpiece or tool": ~np.isin(where, ("workpiece", "tool"))})
    fixed = where == "workpiece"
    if fixed.any() and settings.instrument.on == WORKPIECE:
        hint = "write `instrument: {on: bed}`, or leave these reflectors out"
        raise InputError([reflectors.fault("an instrument on the workpiece sees its reflectors at rest", hint)])
    if "tool" not in table:
        raise InputError([table.fault("the job has reflectors, but the file has no column 'tool'", "it names them")])
    known = {**{name: (False, i) for i, name in enumerate(names)}}
    at_tool = [name for name, on in zip(listed, fixed.tolist(), strict=True) if not on]
    known |= {name: (False, len(names) + i) for i, name in enumerate(at_tool)}
    known |= {name: (True, i) for i, name in enumerate(np.array(listed)[fixed].tolist())}
    read = table.texts("tool")
    unknown = dict.fromkeys(name for name in read if name not in known)
    if unknown:
        raise InputError(
            [
                table.fault_at(read.index(name), f"'{name}' is neither a tool nor a reflector", suggestion(name, known))
                for name in unknown
            ]
        )
    on_workpiece = np.array([known[name][0] for name in read])
    number = np.array([known[name][1] for name in read])
    tool_block, more = _with_tools(blocks[TOOL], reflectors, ~fixed)
    unknowns = {TOOL: tool_block}
    others = [*tool_prior(blocks, settings), *more]
    if fixed.any():
        unknowns[ON_WORKPIECE], known_places = _listed(reflectors, "reflector", fixed)
        others += known_places
    return MeasuredTargets(
        unknowns, np.where(on_workpiece, 0, number), np.where(on_workpiece, number, 0), on_workpiece, tuple(others)
    )


def met_again(
    machine: Machine, observations: Observations, given: Mapping[str, Array], blocks: Mapping[str, Block]
) -> dict[str, Array]:
    """Return the positions of the linear axes that bring the probe to its ball where rotary axes stand elsewhere.

    Empty for readings that no probe makes. A probe that is far from its ball would see scales that it does not.
    """
    if (given.get(OF_TOOL, np.zeros(1)) >= 0).any():
        return {}
    position = np.stack([given[axis.coordinate] for axis in machine.axes])
    ball = blocks[ON_WORKPIECE].values[observations.index[ON_WORKPIECE]].T
    met = brought_to(machine, position, ball, machine.tools[observations.index[TOOL]].T)
    return {axis.coordinate: own for axis, own in zip(machine.axes, met, strict=True) if not axis.turns}


def brought_to(machine: Machine, position: Array, ball: Array, tip: Array) -> Array:
    """Return positions (axes, n) at which linear axes bring tips (3, n) to balls on the workpiece, without errors."""
    moved = seen_from_bed(machine, position, ball, False) - seen_from_bed(machine, position, tip, True)
    return moved_by(machine, position, moved)


def moved_by(machine: Machine, position: Array, way: Array) -> Array:
    """Return positions (axes, n) whose linear axes are moved by ways (3, n) along x, y and z."""
    linear = [i for i, axis in enumerate(machine.axes) if not axis.turns]
    moved = np.array(position)
    moved[linear] += way[[machine.axes[i].number for i in linear]]
    return moved


def _with_tools(tools: Block, listed: Table, chosen: Mask) -> tuple[Block, list[Group]]:
    """Return the block of tools with reflectors at the spindle, and the priors of these."""
    if not chosen.any():
        return tools, []
    own, sigma = listed.stacked("xyz")[chosen], sigmas(listed)[chosen]
    members = (*tools.members, *np.array(listed.texts("reflector"))[chosen].tolist())
    free = np.concatenate([tools.free, sigma != 0])
    block = replace(tools, values=np.concatenate([tools.values, own]), members=members, free=free)
    all_sigma = np.concatenate([np.full(tools.values.shape, np.nan), sigma])
    return block, priors(block, all_sigma, free)


def _listed(listed: Table, key: str, chosen: Mask) -> tuple[Block, list[Group]]:
    """Return the block of points on the workpiece, and the priors of their places."""
    sigma = sigmas(listed)[chosen]
    names = tuple(np.array(listed.texts(key))[chosen].tolist())
    block = Block(
        ON_WORKPIECE,
        listed.stacked("xyz")[chosen],
        ("x", "y", "z"),
        names,
        free=np.asarray(sigma != 0),
        reach=np.array(_REACH),
        noun=key,
    )
    return block, priors(block, sigma, block.free)


def balls_of(settings: Settings, blocks: Mapping[str, Block], table: Table, balls: Table) -> MeasuredTargets:
    """Return the balls that a probe finds; raises InputError for a ball that is not in the list."""
    tool = tools_of(table, settings)
    read = np.unique(np.array(table.texts("ball")))
    used = np.isin(np.array(balls.texts("ball")), read)
    ball = matched(table, "ball", np.array(balls.texts("ball"))[used].tolist(), balls.file)
    block, known = _listed(balls, "ball", used)
    others = (*tool_prior(blocks, settings), *known)
    return MeasuredTargets(
        {TOOL: blocks[TOOL], ON_WORKPIECE: block}, tool, ball, np.ones(len(ball), dtype=bool), others
    )


def with_distances(measured: MeasuredTargets, distances: Table | None) -> MeasuredTargets:
    """Return targets with calibrated distances between points on the workpiece.

    Raises InputError for a name that no reading has.
    """
    if distances is None:
        return measured
    if not measured.workpiece:
        raise InputError([distances.fault("there are no points on the workpiece", "leave the distances out")])
    names = measured.blocks[ON_WORKPIECE].members
    ends = np.stack([matched(distances, end, list(names), "the points that are read") for end in ("from", "to")])
    refuse(
        distances,
        {
            "the distance of a point from itself": ends[0] == ends[1],
            "a standard deviation is not above zero": distances.numbers("sigma") <= 0,
        },
    )
    observed = Observations(
        distances.numbers("length")[None],
        distances.numbers("sigma")[None],
        {ON_WORKPIECE: ends},
        keys={"distance": tuple(f"{names[a]} {names[b]}" for a, b in ends.T)},
        components=("length",),
        unit="mm",
    )
    group = Group("distances", Chain((DistanceBetween(ON_WORKPIECE),)), observed)
    return replace(measured, others=(*measured.others, group))
