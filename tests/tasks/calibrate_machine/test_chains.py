"""Derivatives of the three chains of a machine by every unknown are differences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from simulated import machine as sim

from metrocli.adjust.model.blocks import Block, Space
from metrocli.adjust.model.groups import Group
from metrocli.arrays import Array
from metrocli.tasks.calibrate_machine.machine_settings import MachineNoise
from metrocli.tasks.calibrate_machine.methods.on_the_fly import measurement, on_the_fly
from metrocli.tasks.calibrate_machine.methods.six_dof import six_dof
from metrocli.tasks.calibrate_machine.methods.standstill import standstill
from metrocli.tasks.calibrate_machine.problem import MachineProblem

KNOTS = (4, 4, 3)
"""0 lies on a knot of X and Z, and between two of Y"""


def at_standstill() -> MachineProblem:
    rng = np.random.default_rng(71)
    machine = sim.random_machine(rng, "ZXY", KNOTS)
    return standstill(
        sim.settings(tools=sim.THREE, knots=KNOTS, chain="ZXY", tool_uncertainty=0.01),
        sim.points(machine, rng, 30, sim.THREE),
    )


def along_a_path() -> MachineProblem:
    rng = np.random.default_rng(72)
    machine = sim.random_machine(rng, "YXZ", KNOTS)
    flight = sim.flight(machine, sim.walls(rng, 30), rng, spacing=8.0)
    settings = sim.settings(
        "on-the-fly",
        tools={"": (5.0, -8.0, 120.0)},
        knots=KNOTS,
        chain="YXZ",
        tool_uncertainty=0.01,
        noise=MachineNoise(beam=1e-3, lateral=5e-3),
    )
    return on_the_fly(measurement(settings, flight.path, flight.track)).problem


def with_six_channels() -> MachineProblem:
    rng = np.random.default_rng(73)
    machine = sim.random_machine(rng, "XYZ", KNOTS)
    lines = sim.line_table([sim.line(machine, axis, rng, n=7) for axis in ("x", "y", "z", "xy", "yz", "xz")])
    settings = sim.settings(
        "six-dof",
        tools={"": (0.0, 0.0, 0.0)},
        knots=KNOTS,
        noise=MachineNoise(displacement=5e-4, straightness=1e-3, angle=1e-6),
    )
    return six_dof(settings, lines)


@pytest.mark.parametrize("problem", [at_standstill, along_a_path, with_six_channels])
def test_derivatives_are_differences(problem) -> None:  # type: ignore[no-untyped-def]
    made: MachineProblem = problem()
    rng = np.random.default_rng(74)
    group = made.readings
    blocks = {name: moved(block, rng) for name, block in made.blocks.items()}
    linear = group.linear(blocks, frozenset(group.chain.blocks))
    names = {touch.block for touch in linear.touches}
    assert names == set(group.chain.blocks) - {"leg"}
    for name in names:
        step = rng.normal(size=blocks[name].values.shape)
        along = np.zeros(group.observations.readings.shape)
        for touch in linear.touches:
            if touch.block == name:
                along += np.einsum("dsn,ns->dn", touch.jacobian, step[touch.index])
        expected = group.observations.whitened(by_differences(group, blocks, name, step))
        assert np.abs(along - expected).max() < 1e-5 * np.abs(expected).max() + 1e-6, name


def moved(block: Block, rng: np.random.Generator) -> Block:
    """A block at plausible values that are not zero."""
    if block.space is Space.POSE or block.name in ("leg", "tool"):
        return block
    size = np.array(
        [
            1e-4 if column[1] in "ABC" or "0" in column or column.startswith(("slope", "ea", "eb", "ec")) else 0.05
            for column in block.columns
        ]
    )
    return replace(block, values=block.values + rng.normal(size=block.values.shape) * size)


def by_differences(group: Group, blocks: Mapping[str, Block], name: str, step: Array) -> Array:
    block = blocks[name]
    h = 1e-4 if block.space is Space.POSE else 1e-2
    ends = [group.chain.predict({**blocks, name: block.moved(sign * h * step)}, group.observations) for sign in (1, -1)]
    return (ends[0] - ends[1]) / (2 * h)


@pytest.mark.parametrize(
    ("problem", "seed", "order"),
    [(at_standstill, 71, "ZXY"), (along_a_path, 72, "YXZ"), (with_six_channels, 73, "XYZ")],
    ids=["standstill", "on-the-fly", "six-dof"],
)
def test_values_are_those_of_plain_formulas(problem, seed: int, order: str) -> None:  # type: ignore[no-untyped-def]
    """What the tables add to the readings; a sign wrong in value and derivative together shows here."""
    made: MachineProblem = problem()
    machine = sim.random_machine(np.random.default_rng(seed), order, KNOTS)
    group, blocks = made.readings, dict(made.blocks)
    perfect = group.chain.predict(without_errors(blocks), group.observations)
    for axis in "XYZ":
        block = blocks[f"axis {axis}"]
        values = np.stack([machine.tables[name] for name in block.columns], axis=1)
        blocks[block.name] = replace(block, values=values)
    blocks["squareness"] = replace(blocks["squareness"], values=np.array([machine.squareness]))
    added = group.chain.predict(blocks, group.observations) - perfect
    at = np.stack([group.observations.conditions[axis] for axis in "xyz"], axis=1)
    moved = sim.displacements(machine, at, blocks["tool"].values[group.observations.index["tool"]])
    if "leg" in blocks:
        # across each leg, along two unit vectors of the tracker's frame
        across = blocks["leg"].values[group.observations.index["leg"]].reshape(-1, 2, 3)
        expected = np.einsum("nka,na->nk", across, moved @ sim.rotation(blocks["tracker"].values[0, 3:]))
    elif "tracker" in blocks:
        expected = moved @ sim.rotation(blocks["tracker"].values[0, 3:])
    else:
        expected = np.concatenate([moved, sim.rotations(machine, at)], axis=1)
    assert np.abs(added - expected.T).max() < 1e-12
    assert np.abs(expected).max() > 0.05


def without_errors(blocks: Mapping[str, Block]) -> dict[str, Block]:
    names = ("axis X", "axis Y", "axis Z", "squareness")
    return {**blocks, **{name: replace(blocks[name], values=0 * blocks[name].values) for name in names}}
