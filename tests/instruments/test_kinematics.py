"""Machines with rotary axes: exact products against 4 x 4 matrices, derivatives, signs, and what the gauge holds."""

from __future__ import annotations

import numpy as np
import pytest
from simulated import five_axis as sim

from metrocli.adjust.dense_jacobian import normal_matrix, rows, unknowns_of
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain, Link
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array
from metrocli.instruments import machine as m
from metrocli.instruments.axes import kinematics as k
from metrocli.instruments.axes.chain import errors_by_word
from metrocli.instruments.axes.error_motion import ErrorMotion, ReachedPoint, Undisturbed
from metrocli.instruments.axes.rotary import RotaryAxis, gauge, spindle_block

POSES = 6


def engine(machine: sim.Machine) -> m.Machine:
    """The machine of the program."""
    kind = machine.kind
    left, right = kind.chain.split("b")
    letters = [one for one in "XYZABC" if one in machine.knots]
    axes = tuple(
        m.Axis(one, machine.knots[one])
        if one in "XYZ"
        else RotaryAxis(
            one,
            machine.knots[one],
            kind.at[one],
            machine.sense.get(one, 1),
            bool(np.isclose(np.ptp(machine.knots[one]), 2 * np.pi)),
            one in right,
        )
        for one in letters
    )
    order = tuple(letters.index(one) for one in left + right)
    return m.Machine(order, axes, len(left), np.array(list(kind.tools.values())))


def blocks_of(machine: sim.Machine, found: m.Machine) -> dict[str, Block]:
    """The true values of all unknowns, all of them free."""
    names = errors_by_word(tuple(machine.kind.chain))["all"]
    blocks = [axis.block_of(machine.tables, names) for axis in found.axes]
    blocks += [a.location_block(machine.places, names) for a in found.axes if isinstance(a, RotaryAxis)]
    blocks += [m.squareness_block(machine.places, names), spindle_block(machine.places, names)]
    blocks.append(m.tool_block(found.tools, list(machine.kind.tools), 1.0))
    points = np.array(machine.kind.balls)
    blocks.append(Block(k.ON_WORKPIECE, points, ("x", "y", "z"), tuple("abc")))
    return {block.name: block for block in blocks}


def observed(
    found: m.Machine, poses: list[dict[str, float]], of: tuple[float, float], tool: int, components: int
) -> Observations:
    position = np.array([[pose[axis.letter] for pose in poses] for axis in found.axes])
    n = len(poses)
    index = found.index(position) | {m.TOOL: np.full(n, tool), k.ON_WORKPIECE: np.arange(n) % 3}
    shares = {k.OF_WORKPIECE: np.full(n, of[0]), k.OF_TOOL: np.full(n, of[1])}
    return Observations(np.zeros((components, n)), np.ones(1), index, conditions=found.conditions(position) | shares)


def reading(machine: sim.Machine, pose: dict[str, float], of: tuple[float, float], ball: int, tool: int) -> Array:
    """What is read, by 4 x 4 matrices."""
    workpiece, spindle = machine.sides(pose)
    point = workpiece @ np.append(machine.kind.balls[ball], 1.0)
    tip = spindle @ np.append(list(machine.kind.tools.values())[tool], 1.0)
    return np.asarray((of[0] * point + of[1] * tip)[:3])


@pytest.mark.parametrize("kind", sim.KINDS)
@pytest.mark.parametrize("of", [(0.0, 1.0), (1.0, 0.0), (1.0, -1.0)], ids=["tool", "workpiece", "both"])
def test_points_are_products_of_matrices(kind: str, of: tuple[float, float]) -> None:
    """With errors of 3 mm and 10 mrad, to rounding."""
    rng = np.random.default_rng(2)
    machine = sim.drawn(sim.KINDS[kind], rng, 100.0)
    found, tool = engine(machine), len(machine.kind.tools) - 1
    poses = [machine.drawn_pose(rng) for _ in range(POSES)]
    observations = observed(found, poses, of, tool, 3)
    chain = Chain((Undisturbed(found), k.FromBed(found, True)))
    expected = [reading(machine, pose, of, i % 3, tool) for i, pose in enumerate(poses)]
    assert np.abs(chain.predict(blocks_of(machine, found), observations).T - expected).max() < 1e-9


@pytest.mark.parametrize("kind", sim.KINDS)
@pytest.mark.parametrize("sense", [1, -1])
def test_the_tip_on_the_workpiece_and_its_error(kind: str, sense: int) -> None:
    rng = np.random.default_rng(3)
    machine = sim.drawn(sim.KINDS[kind], rng, 10.0)
    machine.sense = dict.fromkeys("ABC", sense)
    found = engine(machine)
    poses = [machine.drawn_pose(rng) for _ in range(POSES)]
    observations = observed(found, poses, (0, 1), 0, 3)
    blocks = blocks_of(machine, found)
    tip = Chain((Undisturbed(found), k.OnWorkpiece(found))).predict(blocks, observations).T
    nominal, errors = sim.errors_at(machine, poses, np.array(next(iter(machine.kind.tools.values()))))
    assert np.abs(tip - nominal - errors).max() < 1e-9
    motion = Chain(k.motion(found)).predict(blocks, observations).T
    assert np.abs(motion[:, :3] - errors).max() < 1e-9


LINKS = [
    ("table-table", lambda found: k.FromBed(found, True), (1.0, -1.0), 3),
    ("head-table", k.OnWorkpiece, (0.0, 1.0), 3),
    ("head-head", k.TipMotion, (0.0, 1.0), 6),
]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "link", "of", "size"), LINKS, ids=[one[0] for one in LINKS])
def test_derivatives_are_those_of_the_values(kind: str, link, of: tuple[float, float], size: int) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(4)
    machine = sim.drawn(sim.KINDS[kind], rng, 10.0)
    found = engine(machine)
    blocks = blocks_of(machine, found)
    poses = [machine.drawn_pose(rng) for _ in range(POSES)]
    observations = observed(found, poses, of, 0, size)
    own: Link = link(found)
    group = Group("", Chain((Undisturbed(found), own)), observations)
    names = [name for name in own.blocks if blocks[name].free.any()]
    unknowns = unknowns_of(blocks, names)
    design = rows(group, blocks, unknowns)
    places = {place: i for i, place in enumerate(unknowns.names(blocks))}
    for name, column in dict.fromkeys((name, column) for name, _, column in places):
        block = blocks[name]
        # all knots of a table at once, each by another amount
        here = [(member, i) for (table, member, term), i in places.items() if (table, term) == (name, column)]
        knots = [(block.members.index(member), i) for member, i in here]
        small = 1e-5 if len(column) > 1 and m.is_angle(column) else 1e-2
        share = rng.uniform(0.5, 1, len(knots)) * rng.choice([-1, 1], len(knots))
        step = np.zeros(block.values.shape)
        step[[at for at, _ in knots], block.column(column)] = small * share
        sides = [group.chain.predict({**blocks, name: block.moved(sign * step)}, observations) for sign in (1, -1)]
        expected = (sides[0] - sides[1]) / (2 * small)
        along = design[:, :, [i for _, i in knots]] @ share
        # a rotation vector changes by a turn from the left only up to its own size, here some 1e-3
        loose = 1e-2
        assert np.abs(along[:3] - expected[:3]).max() < 1e-6 * max(1, np.abs(expected).max()), (name, column)
        assert np.abs(along[3:] - expected[3:]).max(initial=0.0) < loose, (name, column)


@pytest.mark.alike
@pytest.mark.parametrize("kind", sim.KINDS)
def test_errors_added_to_axes_have_their_derivatives(kind: str) -> None:
    rng = np.random.default_rng(5)
    machine = sim.drawn(sim.KINDS[kind], rng, 10.0)
    found = engine(machine)
    blocks = blocks_of(machine, found)
    observations = observed(found, [machine.drawn_pose(rng) for _ in range(POSES)], (1, -1), 0, 3)
    link = k.FromBed(found, True)
    value = rng.normal(size=(m.ROWS * len(found.axes), POSES)) * 1e-4
    from metrocli.adjust.model.chain import LinkContext

    local = LinkContext(blocks, observations, frozenset())
    by_input = link.step(value, local).by_input
    assert by_input is not None
    for row in range(len(value)):
        step = np.zeros_like(value)
        step[row] = 1e-5
        expected = (link.step(value + step, local).value - link.step(value - step, local).value) / 2e-5
        assert np.abs(by_input[:, row] - expected).max() < 1e-6 * max(1, np.abs(expected).max())


def test_the_first_order_of_three_axes_is_that_of_the_product() -> None:
    """At no error both models of a machine with three linear axes have the same derivatives."""
    rng = np.random.default_rng(6)
    machine = sim.drawn(sim.KINDS["head-head"], rng)
    whole = engine(machine)
    for order in ((0, 1, 2), (2, 0, 1), (1, 2, 0)):
        found = m.Machine(order, whole.axes[:3], 0, whole.tools)
        blocks = {name: block.with_values(0 * block.values) for name, block in blocks_of(machine, whole).items()}
        blocks[m.TOOL] = m.tool_block(whole.tools, list(machine.kind.tools), 0.0)
        poses = [machine.drawn_pose(rng) for _ in range(POSES)]
        observations = observed(found, poses, (0, 1), 2, 3)
        names = [*(axis.block for axis in found.axes), m.SQUARENESS]
        unknowns = unknowns_of(blocks, names)
        exact = Group("", Chain((Undisturbed(found), k.FromBed(found))), observations)
        first = Group("", Chain((Undisturbed(found), ErrorMotion(found), ReachedPoint())), observations)
        assert np.abs(rows(exact, blocks, unknowns) - rows(first, blocks, unknowns)).max() < 1e-9


@pytest.mark.parametrize(("axis", "stands"), [("B", (-2.0, 0.0, 1.0)), ("C", (0.0, -1.0, 2.0))], ids=["B 90", "C 90"])
def test_signs_are_those_of_the_published_example(axis: str, stands: tuple[float, float, float]) -> None:
    """LinuxCNC issue 2435, conventional directions: a trunnion BC with pivots at 0, the tip at (1, 0, 2)."""
    axes = (
        *(m.Axis(one, np.array([-9.0, 9.0])) for one in "XYZ"),
        *(RotaryAxis(one, np.radians([-180.0, 180.0])) for one in "BC"),
    )
    machine = m.Machine((4, 3, 0, 1, 2), axes, 2, np.zeros((1, 3)))
    position = np.array([[np.pi / 2 if one.letter == axis else 0.0] for one in axes])
    place = k.seen_from_bed(machine, position, np.array([[1.0], [0.0], [2.0]]), False)
    assert place[:, 0] == pytest.approx(stands, abs=1e-12)
    position[:3] = place
    assert k.nominal_tip(machine, position, np.array([0]))[0][:, 0] == pytest.approx((1.0, 0.0, 2.0), abs=1e-12)


@pytest.mark.parametrize("kind", sim.KINDS)
def test_without_conditions_twenty_directions_are_open_and_with_them_none(kind: str) -> None:
    """Two axes read at their knots, with everything else known that the contract knows: 20, and 0."""
    rng = np.random.default_rng(7)
    machine = sim.drawn(sim.KINDS[kind], rng, 0.0, linear=False)
    found = engine(machine)
    names = errors_by_word(tuple(machine.kind.chain))["rotary"]
    blocks = blocks_of(machine, found)
    for axis in found.axes:
        blocks[axis.block] = axis.block_of({}, names)
    blocks[m.SQUARENESS] = blocks[m.SQUARENESS].fixed()
    blocks[m.TOOL] = blocks[m.TOOL].fixed()
    turning = [axis for axis in found.axes if isinstance(axis, RotaryAxis)]
    poses = []
    for first in turning[0].members:
        for second in turning[1].members:
            own = machine.drawn_pose(rng)
            poses += [own | {turning[0].letter: float(first), turning[1].letter: float(second)}] * 9
    observations = observed(found, poses, (1, -1), 0, 3)
    tools = np.arange(len(poses)) // 3 % len(machine.kind.tools)
    observations = observations.__class__(
        observations.readings, observations.sigma, {**observations.index, m.TOOL: tools},
        conditions=observations.conditions,
    )  # fmt: skip
    readings = Group("", Chain((Undisturbed(found), k.FromBed(found, True))), observations)
    unknowns = unknowns_of(blocks, [name for name in readings.chain.blocks if blocks[name].free.any()])
    held = [one.with_noise_times(1e6) for one in gauge(found, blocks)]
    for groups, expected in (([readings], 20), ([readings, *held], 0)):
        matrix = normal_matrix(groups, blocks, unknowns)
        scale = np.sqrt(np.diag(matrix))
        values = np.linalg.eigvalsh(matrix / scale[:, None] / scale)
        assert int((values < 1e-9 * values[-1]).sum()) == expected
