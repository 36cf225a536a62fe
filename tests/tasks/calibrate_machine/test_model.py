"""The rigid-body model: the printed formulas, exact transforms, and the gauge."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from simulated import machine as sim

from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array
from metrocli.instruments import machine as m
from metrocli.instruments.axes.chain import axis_order
from metrocli.instruments.axes.kinematics import motion

ORDERS = ["".join(order) for order in permutations("XYZ")]


def engine(machine: sim.Machine, positions: Array, tool: Array) -> Array:
    """What the instrument's link predicts, (n, 6)."""
    axes = [m.Axis(a, machine.positions(a)) for a in "XYZ"]
    model = m.Machine(axis_order(machine.order), (axes[0], axes[1], axes[2]))
    blocks = {axis.block: axis.block_of(machine.tables, m.ALL_NAMES) for axis in axes}
    blocks[m.SQUARENESS] = m.squareness_block(
        dict(zip(m.SQUARENESS_NAMES, machine.squareness, strict=True)), m.ALL_NAMES
    )
    blocks[m.TOOL] = m.tool_block(tool[None], [""], 0.0)
    n = len(positions)
    index = model.index(positions.T) | {m.TOOL: np.zeros(n, dtype=int)}
    observations = Observations(
        np.zeros((6, n)), np.ones(1), index, conditions=dict(zip("xyz", positions.T, strict=True))
    )
    return Group("", Chain(motion(model)), observations).chain.predict(blocks, observations).T


@pytest.mark.alike
@pytest.mark.parametrize("bed", range(4))
@pytest.mark.parametrize("order", ORDERS)
def test_what_the_formula_leaves_of_exact_transforms_is_of_second_order(order: str, bed: int) -> None:
    """For every order of axes, wherever the bed stands: ten times smaller errors leave a hundredth."""
    positions, tool = sim.commands(np.random.default_rng(0), 40), np.array([30.0, -20.0, 120.0])
    left = []
    for size in (0.05, 0.005):
        machine = sim.random_machine(np.random.default_rng(1), order, size=size)
        exact = np.array([machine.exact(p, tool, bed) for p in positions])
        left.append(np.abs(engine(machine, positions, tool)[:, :3] - exact).max())
        assert left[-1] < 0.002 * np.abs(exact).max()
    assert 90 < left[0] / left[1] < 110


@pytest.mark.parametrize("order", ORDERS)
def test_it_is_the_contracts_formula_to_rounding(order: str) -> None:
    rng = np.random.default_rng(2)
    machine = sim.random_machine(rng, order)
    positions, tool = sim.commands(rng, 40), np.array([30.0, -20.0, 120.0])
    expected = np.array([machine.first_order(p, tool) for p in positions])
    assert np.abs(engine(machine, positions, tool)[:, :3] - expected).max() < 1e-12


PRINTED = {
    "XYZ": lambda e, x, y, z, t: (
        e["EBX"] * (z + t[2])
        - e["ECX"] * (y + t[1])
        + e["EBY"] * (z + t[2])
        - e["ECY"] * t[1]
        + e["EBZ"] * t[2]
        - e["ECZ"] * t[1],
        e["ECX"] * t[0]
        - e["EAX"] * (z + t[2])
        + e["ECY"] * t[0]
        - e["EAY"] * (z + t[2])
        + e["ECZ"] * t[0]
        - e["EAZ"] * t[2],
        e["EAX"] * (y + t[1]) - e["EBX"] * t[0] + e["EAY"] * t[1] - e["EBY"] * t[0] + e["EAZ"] * t[1] - e["EBZ"] * t[0],
    ),
    "YXZ": lambda e, x, y, z, t: (
        e["EBY"] * (z + t[2])
        - e["ECY"] * t[1]
        + e["EBX"] * (z + t[2])
        - e["ECX"] * t[1]
        + e["EBZ"] * t[2]
        - e["ECZ"] * t[1],
        e["ECY"] * (x + t[0])
        - e["EAY"] * (z + t[2])
        + e["ECX"] * t[0]
        - e["EAX"] * (z + t[2])
        + e["ECZ"] * t[0]
        - e["EAZ"] * t[2],
        e["EAY"] * t[1] - e["EBY"] * (x + t[0]) + e["EAX"] * t[1] - e["EBX"] * t[0] + e["EAZ"] * t[1] - e["EBZ"] * t[0],
    ),
    "XZY": lambda e, x, y, z, t: (
        e["EBX"] * (z + t[2])
        - e["ECX"] * (y + t[1])
        + e["EBZ"] * t[2]
        - e["ECZ"] * (y + t[1])
        + e["EBY"] * t[2]
        - e["ECY"] * t[1],
        e["ECX"] * t[0] - e["EAX"] * (z + t[2]) + e["ECZ"] * t[0] - e["EAZ"] * t[2] + e["ECY"] * t[0] - e["EAY"] * t[2],
        e["EAX"] * (y + t[1])
        - e["EBX"] * t[0]
        + e["EAZ"] * (y + t[1])
        - e["EBZ"] * t[0]
        + e["EAY"] * t[1]
        - e["EBY"] * t[0],
    ),
    "ZXY": lambda e, x, y, z, t: (
        e["EBZ"] * t[2]
        - e["ECZ"] * (y + t[1])
        + e["EBX"] * t[2]
        - e["ECX"] * (y + t[1])
        + e["EBY"] * t[2]
        - e["ECY"] * t[1],
        e["ECZ"] * (x + t[0]) - e["EAZ"] * t[2] + e["ECX"] * t[0] - e["EAX"] * t[2] + e["ECY"] * t[0] - e["EAY"] * t[2],
        e["EAZ"] * (y + t[1])
        - e["EBZ"] * (x + t[0])
        + e["EAX"] * (y + t[1])
        - e["EBX"] * t[0]
        + e["EAY"] * t[1]
        - e["EBY"] * t[0],
    ),
}


@pytest.mark.parametrize("order", PRINTED)
def test_four_chains_are_as_they_are_printed(order: str) -> None:
    rng = np.random.default_rng(3)
    machine = sim.random_machine(rng, order)
    a, b, c = machine.squareness
    tool = np.array([30.0, -20.0, 120.0])
    for p in sim.commands(rng, 20):
        e = {
            f"E{d}{axis}": machine.errors(axis, p["XYZ".index(axis)])["XYZABC".index(d)]
            for axis in "XYZ"
            for d in "XYZABC"
        }
        shifts = np.array([sum(e[f"E{d}{axis}"] for axis in "XYZ") for d in "XYZ"])
        turned = np.array(PRINTED[order](e, *p, tool))
        expected = shifts + turned + [-c * p[1] + b * p[2], -a * p[2], 0.0]
        assert np.abs(engine(machine, p[None], tool)[0, :3] - expected).max() < 1e-12


@pytest.mark.parametrize(
    ("chain", "order"),
    [("wXbYZt", "XYZ"), ("wbYXZt", "YXZ"), ("[w X b Y Z t]", "XYZ"), ("ZXY", "ZXY"), ("wXYZbt", "XYZ"), ("XYZ", "XYZ")],
)
def test_chains_are_read(chain: str, order: str) -> None:
    assert "".join("XYZ"[i] for i in axis_order(chain)) == order


@pytest.mark.parametrize("chain", ["", "wXbYt", "XXZ", "wXbYbZt", "xyz", "tZYbXw", "bwXYZ"])
def test_what_is_no_chain_is_refused(chain: str) -> None:
    with pytest.raises(ValueError, match="is not a chain"):
        axis_order(chain)


@pytest.mark.parametrize(
    ("low", "high", "n", "reference"),
    [
        (-260.0, 260.0, 6, 0.0),
        (0.0, 600.0, 7, 0.0),
        (100.0, 700.0, 4, 100.0),
        (-500.0, -50.0, 5, -500.0),
        (-1.0, 9.0, 3, 0.0),
    ],
)
def test_tables_are_in_the_gauge_whatever_the_raw_values(low: float, high: float, n: int, reference: float) -> None:
    """Positioning and angles are 0 at 0, or at the lowest position where 0 is outside; straightness is 0 at the ends."""
    axis = m.Axis("Y", np.linspace(low, high, n))
    assert axis.reference == reference
    rng = np.random.default_rng(5)
    raw = np.where(axis.free(m.ALL_NAMES), rng.normal(size=(n, 6)), 0.0)
    tables = np.stack([axis.from_raw[k] @ raw[:, k] for k in range(6)], axis=1)
    at_reference = np.array([np.interp(reference, axis.knots, tables[:, k]) for k in range(6)])
    assert np.abs(at_reference[~axis.straightness]).max() < 1e-15
    assert np.abs(tables[[0, -1]][:, axis.straightness]).max() == 0.0
    # as many unknowns as the gauge leaves
    assert axis.free(m.ALL_NAMES).sum() == 4 * (n - 1) + 2 * (n - 2)


def test_a_block_gives_back_the_tables_it_was_made_from() -> None:
    machine = sim.random_machine(np.random.default_rng(6), knots=(5, 6, 4))
    for letter in "XYZ":
        axis = m.Axis(letter, machine.positions(letter))
        raw = axis.block_of(machine.tables, m.ALL_NAMES).values
        for k, name in enumerate(m.errors_of(letter)):
            assert np.abs(axis.from_raw[k] @ raw[:, k] - machine.tables[name]).max() < 1e-15
