"""Positions of rotary axes that are estimated, because the axis has no encoder or nobody read it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.instruments.axes.error_motion import positions_block
from metrocli.instruments.machine import Machine
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.machine_settings import ESTIMATED
from metrocli.tasks.calibrate_machine.settings import Settings

_RUN = "run"


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
    runs = np.array(points.texts(_RUN) if _RUN in points else ("",) * len(points))
    found = PositionsOfAxes()
    for axis, own in zip(machine.axes, position, strict=True):
        if axis.letter in estimated:
            # nine digits: two positions that differ in the file must not become one
            named = zip(runs.tolist(), np.degrees(own).tolist(), strict=True)
            names = [f"{run} {at:.9g}".strip() for run, at in named]
            number = {name: i for i, name in enumerate(dict.fromkeys(names))}
            block = positions_block(axis.letter, list(number))
            index = {block.name: np.array([number[name] for name in names], dtype=np.intp)}
            found = PositionsOfAxes(
                {**found.blocks, block.name: block}, {**found.index, **index}, (*found.letters, axis.letter)
            )
    return found
