"""Every link of a chain: its derivatives are those of its values, and chains join only where frames meet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from metrocli.adjust.model import groups, quantities
from metrocli.adjust.model.blocks import Block, Space
from metrocli.adjust.model.chain import Chain, Link, LinkContext, Step, Varied
from metrocli.adjust.model.groups import Group, ReadBlock
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array
from metrocli.effects.links.lens_shape import Knots, LensShape
from metrocli.geometry import poses
from metrocli.instruments import frames, launch_unit, spindle_camera, tracer
from metrocli.instruments.frames import DistanceBetween, FromFrame, PointOf, ToFrame
from metrocli.instruments.launch_unit import AboutBase, BeamBack, BeamLength, BeamOut, Encoders, Reading
from metrocli.instruments.lenses import lens
from metrocli.instruments.lenses.lens import PARAMETERS, Lens, LensBackward
from metrocli.instruments.spindle_camera import Coupling, UncertainPoses
from metrocli.instruments.tracer import LengthFrom, Returned

N = 9
ON_TARGETS, IN_CAMERA = Quantity.POINT_ON_TARGETS, Quantity.POINT_IN_CAMERA
RNG = np.random.default_rng(20)
POSES = RNG.normal(size=(4, 6)) * [100, 100, 100, 0.8, 0.8, 0.8]
POINTS = RNG.normal(size=(5, 3)) * 200
COEFFICIENTS = {"k1": -0.2, "k2": 0.11, "k3": -0.03, "p1": 2e-3, "p2": -1e-3}
RATIONAL = {"k4": 0.05, "k5": -0.04, "k6": 0.02}
PRISM = {"s1": 3e-3, "s2": -2e-3, "s3": 1e-3, "s4": 4e-3}
CENTRE = {"cx": 1200.0, "cy": 890.0}
TRACERS = np.array(
    [[-900.0, 40.0, 300.0, 0.3, 1.0], [800.0, -500.0, 100.0, -200.0, 1.02], [400.0, 900.0, 2e3, 10.0, 0.98]]
)
ONE_F, TWO_F = {"f": 2500.0}, {"fx": 2510.0, "fy": 2490.0}
ALL = {**ONE_F, "aspect": 0.02, **CENTRE, "skew": 0.01, **COEFFICIENTS, **RATIONAL, **PRISM}


@dataclass(frozen=True)
class Warmer:
    """A lens whose focal length grows from reading to reading, and whose principal point moves: an effect on its parameters."""

    name: str = "warmth"
    varies: str = "lens"
    takes = gives = Quantity.PARAMETERS

    @property
    def blocks(self) -> tuple[str, ...]:
        return (self.name,)

    def step(self, value: Array, local: LinkContext) -> Step:
        rate, shift = local.rows(self.name)
        order, f, cx = np.arange(N), *(local.blocks["lens"].column(name) for name in ("f", "cx"))
        changed, by_value, by_own = (
            value.copy(),
            np.repeat(np.eye(len(value))[:, :, None], N, axis=2),
            np.zeros((len(value), 2, N)),
        )
        changed[f] *= 1 + rate * order
        changed[cx] += shift
        by_value[f, f], by_own[f, 0], by_own[cx, 1] = 1 + rate * order, value[f] * order, 1.0
        return Step(changed, by_value, {self.name: by_own})


def pose_block(name: str, members: int) -> Block:
    return Block(name, POSES[:members], poses.COLUMNS, tuple("abcd"[:members]), space=Space.POSE)


def point_block(members: int) -> Block:
    return Block("points", POINTS[:members], ("x", "y", "z"), tuple("abcde"[:members]))


def lens_block(**values: float) -> Block:
    return Block("lens", np.array([list(values.values())]), tuple(values))


def lens_blocks(**values: float) -> Block:
    """Three lenses, each a little different."""
    rows = np.array([list(values.values())]) * [[1.0], [1.02], [0.97]]
    return Block("lens", rows, tuple(values), ("a", "b", "c"))


AIR_BLOCK = Block("air", np.array([[0.01]]), ("scale",))


def unit_block() -> Block:
    return Block("launch unit", np.array([[-300.0, 400.0, 100.0, 2.5]]), launch_unit.COLUMNS)


@dataclass(frozen=True)
class Case:
    """A link at some values."""

    link: Link
    blocks: tuple[Block, ...]
    touched: int = 1
    largest: float = 2400.0
    """Of the readings"""
    value_size: int = 3
    """Components of what comes in"""

    def local(self, blocks: tuple[Block, ...]) -> LinkContext:
        rng = np.random.default_rng(5)
        shape = (self.touched, N) if self.touched > 1 else (N,)
        index = {block.name: rng.integers(len(block.members), size=shape) for block in blocks}
        if self.touched > 1:
            index = {name: np.stack([np.arange(N) % 5, (np.arange(N) + 2) % 5]) for name in index}
        readings = np.stack([rng.uniform(0, self.largest, N), rng.uniform(0, self.largest * 0.75, N)])
        return LinkContext(
            {block.name: block for block in blocks}, Observations(readings, np.ones(1), index), self.wanted
        )

    @property
    def wanted(self) -> frozenset[str]:
        return frozenset(self.link.blocks)

    def value(self) -> Array:
        rng = np.random.default_rng(6)
        if self.link.takes is None:
            return np.zeros((0, N))
        if self.value_size == 2:
            return rng.normal(size=(2, N))
        point = rng.normal(size=(3, N)) * 150
        return point + np.array([0, 0, 700.0])[:, None]


def away(block: Block, seed: int = 3) -> Array:
    """Reference values near those of a block."""
    return block.moved(np.random.default_rng(seed).normal(size=block.values.shape) * 0.1).values


def reading(block: Block, columns: tuple[int, ...]) -> ReadBlock:
    return ReadBlock(block.name, away(block), columns, block.space)


CASES: dict[str, Case] = {
    "PointOf": Case(PointOf("points", ON_TARGETS, (1.0, -2.0, 3.0)), (point_block(5),)),
    "PointOf, one": Case(PointOf("points", ON_TARGETS), (point_block(1),)),
    "FromFrame": Case(FromFrame("pose", ON_TARGETS, IN_CAMERA), (pose_block("pose", 4),)),
    "FromFrame, one": Case(FromFrame("pose", ON_TARGETS, IN_CAMERA), (pose_block("pose", 1),)),
    "ToFrame": Case(ToFrame("pose", ON_TARGETS, IN_CAMERA), (pose_block("pose", 4),)),
    "ToFrame, one": Case(ToFrame("pose", ON_TARGETS, IN_CAMERA), (pose_block("pose", 1),)),
    "DistanceBetween": Case(DistanceBetween("points"), (point_block(5),), touched=2),
    "Returned": Case(Returned(), (Block("stop", POINTS, tuple("xyz"), tuple("abcde")),)),
    "LengthFrom": Case(LengthFrom(), (Block("tracer", TRACERS, tracer.COLUMNS, tuple("abc")),)),
    "LengthFrom, in air": Case(
        LengthFrom(in_air=True), (Block("tracer", TRACERS, tracer.COLUMNS, tuple("abc")), AIR_BLOCK)
    ),
    "BeamOut": Case(BeamOut(), (unit_block(),)),
    "BeamBack": Case(BeamBack(), (unit_block(),)),
    "AboutBase, one": Case(AboutBase("launch unit", 3, Quantity.BEAM_OUT, Quantity.BEAM_AT_LAUNCH), (unit_block(),)),
    "AboutBase": Case(
        AboutBase("spindle", 0, Quantity.BEAM_BACK, Quantity.BEAM_AT_RECEIVER),
        (Block("spindle", np.array([[0.4], [-2.9]]), ("psi",), ("a", "b")),),
    ),
    "Encoders": Case(Encoders(Quantity.BEAM_AT_LAUNCH, Quantity.LAUNCH_ANGLES), ()),
    "Reading": Case(Reading(Quantity.LAUNCH_ANGLES, 0), (), value_size=2, largest=8.0),
    "BeamLength": Case(BeamLength(), ()),
    "BeamLength, in air": Case(BeamLength(in_air=True), (AIR_BLOCK,)),
    "Coupling": Case(Coupling("coupling"), (Block("coupling", np.array([[0.4]]), ("gamma_s",)),)),
    "Coupling, several": Case(
        Coupling("coupling"), (Block("coupling", np.array([[0.4], [-0.2]]), ("gamma_s",), ("a", "b")),)
    ),
    "UncertainPoses": Case(
        UncertainPoses(np.random.default_rng(21).normal(size=(4, 6, 3)) * 0.1),
        (pose_block("spindle", 4), Block("machine", np.array([[0.4, -1.1, 0.7]]), ("a", "b", "c"))),
    ),
    "ReadBlock": Case(reading(point_block(5), (0, 2)), (point_block(5),)),
    "ReadBlock, poses": Case(reading(pose_block("pose", 4), (1, 3, 4, 5)), (pose_block("pose", 4),)),
    **{
        f"{kind.__name__}, {name}": Case(kind(), (lens_block(**values),))
        for kind in (Lens, LensBackward)
        for name, values in {
            "pinhole": {**ONE_F, **CENTRE},
            "usual": {**ONE_F, **CENTRE, **COEFFICIENTS},
            "fx fy": {**TWO_F, **CENTRE, **COEFFICIENTS},
            "fx fy skew": {**TWO_F, "skew": -0.02, **CENTRE, **COEFFICIENTS},
            "aspect": {**ONE_F, "aspect": 0.03, **CENTRE, **COEFFICIENTS},
            "rational": {**ONE_F, **CENTRE, **COEFFICIENTS, **RATIONAL},
            "prism": {**ONE_F, **CENTRE, **PRISM},
            "all": ALL,
            "all, distortion 0": {**ALL, **dict.fromkeys([*COEFFICIENTS, *RATIONAL, *PRISM], 0.0)},
        }.items()
    },
    **{
        f"tilted, {name}": Case(Lens(), (lens_block(**{**ONE_F, **CENTRE, **values, "tau_x": 0.03, "tau_y": -0.02}),))
        for name, values in {"usual": COEFFICIENTS, "pinhole": {"tau_x": 0.0}}.items()
    },
    "LensShape": Case(
        LensShape(Knots((2400, 1800), (7, 6)), np.random.default_rng(4).normal(size=(84, 5))),
        (Block("lens-shape", np.array([[3.0, -2.0, 1.0, 4.0, -1.0]]), ("w1", "w2", "w3", "w4", "w5")),),
        value_size=2,
    ),
    "fisheye": Case(Lens(fisheye=True), (lens_block(**{**ALL, "tau_x": 0.03, "tau_y": -0.02, "k5": 0.0, "k6": 0.0}),)),
    **{f"{kind.__name__}, several": Case(kind(), (lens_blocks(**ALL),)) for kind in (Lens, LensBackward)},
    "Varied": Case(
        Varied(Lens(), "lens", Warmer()),
        (lens_block(**ALL), Block("warmth", np.array([[1e-3, 2.0]]), ("rate", "shift"))),
    ),
    "Varied, backward": Case(
        Varied(LensBackward(), "lens", Warmer()),
        (lens_block(**ALL), Block("warmth", np.array([[1e-3, 2.0]]), ("rate", "shift"))),
    ),
    "Varied, several": Case(
        Varied(Lens(), "lens", Warmer()),
        (lens_blocks(**ALL), Block("warmth", np.array([[1e-3, 2.0]]), ("rate", "shift"))),
    ),
    "Varied twice": Case(
        Varied(Varied(Lens(), "lens", Warmer()), "lens", Warmer("sun")),
        (lens_block(**ALL), *(Block(name, np.array([[1e-3, 2.0]]), ("rate", "shift")) for name in ("warmth", "sun"))),
    ),
}


def differences(function: Callable[[float], Array], step: float) -> Array:
    """Derivative at 0 by four values."""
    near, far = (function(h) - function(-h) for h in (step, 2 * step))
    derivative: Array = (8 * near - far) / (12 * step)
    return derivative


def spread(values: Array) -> Array:
    return np.broadcast_to(values, (*values.shape[:-1], N))


def close(found: Array, expected: Array, scale: float) -> bool:
    return bool(np.abs(found - expected).max() <= 1e-9 * max(scale, float(np.abs(expected).max()), 1e-300))


def test_the_table_has_every_link() -> None:
    modules = (frames, lens, spindle_camera, groups, tracer, launch_unit)
    classes = {
        c.__name__
        for module in modules
        for c in vars(module).values()
        if isinstance(c, type) and hasattr(c, "step") and hasattr(c, "gives") and c is not Link
    }
    # joint priors have tests of their own: their slots are the members, not the readings
    # links of the machine have tests of their own (test_model.py)
    apart = {"PointOf", "ReadEntries", "ReadBlocks", "ErrorMotion", "ReachedPoint"}
    assert classes | {"Coupling"} <= {type(case.link).__name__ for case in CASES.values()} | apart
    assert {
        name for case in CASES.values() for block in case.blocks if block.name == "lens" for name in block.columns
    } == set(PARAMETERS)


@pytest.mark.parametrize("columns", [(4,), (0, 3)])
def test_a_joint_prior_of_members_is_the_squared_distance_in_its_covariance(columns: tuple[int, ...]) -> None:
    rng = np.random.default_rng(61)
    members, size = np.array([0, 2, 3]), 3 * len(columns)
    root = rng.normal(size=(size, size))
    covariance = root @ root.T + np.eye(size)
    block = Block("tracer", rng.normal(size=(4, 5)), tuple("xyzds"), tuple("abcd"))
    group = groups.prior_of_members(block, columns, covariance, members)
    at = np.ix_(members, columns)
    off = np.zeros((4, 5))
    off[at] = rng.normal(size=(3, len(columns)))
    moved = {block.name: block.moved(off)}
    linear = group.linear(moved, frozenset(moved))
    expected = np.zeros((4, 5))
    expected[at] = -np.linalg.solve(covariance, off[at].ravel()).reshape(3, -1)
    assert np.isclose(linear.cost, -(off * expected).sum())
    gradient = np.zeros((4, 5))
    for touch in linear.touches:
        gradient[touch.index[0]] += linear.residual[:, 0] @ touch.jacobian[:, :, 0]
    assert np.allclose(gradient, expected)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_derivative_by_the_input(case: Case) -> None:
    value, local = case.value(), case.local(case.blocks)
    step = case.link.step(value, local)
    if case.link.takes is None:
        assert step.by_input is None
        return
    assert step.by_input is not None
    for i in range(len(value)):
        along = np.eye(len(value))[i][:, None]
        expected = differences(lambda h, along=along: case.link.step(value + h * along, local).value, 0.05)
        assert close(spread(step.by_input)[:, i], spread(expected), 0.0)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_derivatives_by_the_blocks(case: Case) -> None:
    value, local = case.value(), case.local(case.blocks)
    step = case.link.step(value, local)
    assert set(step.by_block) == case.wanted
    for at, block in enumerate(case.blocks):
        index = local.index(block.name)
        for member in range(len(block.members)):
            for column in range(block.size):
                move = np.zeros(block.values.shape)
                move[member, column] = 1

                def moved(h: float, move: Array = move, at: int = at) -> Array:
                    blocks = (*case.blocks[:at], case.blocks[at].moved(h * move), *case.blocks[at + 1 :])
                    return spread(case.link.step(value, case.local(blocks)).value)

                angle = block.space is Space.POSE and column > 2
                size = 2e-3 if angle or block.name == "coupling" else 1e-3 * max(1.0, abs(block.values[member, column]))
                expected = differences(moved, size)
                jacobian = step.by_block[block.name]
                slots = jacobian if jacobian.ndim == 4 else jacobian[None]
                touches = np.atleast_2d(index) == member
                found = sum(spread(slot)[:, column] * touch for slot, touch in zip(slots, touches, strict=True))
                assert close(found, expected, 0.0), (block.name, block.columns[column])


def test_a_link_leaves_out_derivatives_that_nobody_wants() -> None:
    for case in (CASES["Lens, all"], CASES["FromFrame"], CASES["ToFrame"], CASES["PointOf"]):
        step = case.link.step(case.value(), replace(case.local(case.blocks), wanted=frozenset()))
        assert not step.by_block


def test_points_behind_the_camera_have_no_image() -> None:
    case = CASES["Lens, all"]
    for kind in (Lens, LensBackward):
        uv = kind().step(case.value() * [[1], [1], [-1]], case.local(case.blocks)).value
        assert np.isnan(uv).all()


CHAINS = {
    "board": (PointOf("points", ON_TARGETS), FromFrame("pose", ON_TARGETS, IN_CAMERA), Lens()),
    "network": (PointOf("points", ON_TARGETS), ToFrame("pose", ON_TARGETS, IN_CAMERA), Lens()),
    "backward": (PointOf("points", ON_TARGETS), ToFrame("pose", ON_TARGETS, IN_CAMERA), LensBackward()),
    "part": (
        PointOf("points", Quantity.POINT_IN_PART),
        FromFrame("part", Quantity.POINT_IN_PART, Quantity.POINT_IN_MACHINE),
        ToFrame("pose", Quantity.POINT_IN_MACHINE, Quantity.POINT_IN_SPINDLE),
        Coupling(),
        ToFrame("taper", Quantity.POINT_IN_TAPER, IN_CAMERA),
        Lens(),
    ),
    "one pose twice": (
        PointOf("points", Quantity.POINT_IN_PART),
        FromFrame("pose", Quantity.POINT_IN_PART, Quantity.POINT_IN_MACHINE),
        ToFrame("pose", Quantity.POINT_IN_MACHINE, IN_CAMERA),
        Lens(),
    ),
}


@pytest.mark.parametrize("name", CHAINS)
def test_derivatives_of_a_whole_chain(name: str) -> None:
    """By the chain rule backwards, with n = 1 blocks and many, whitened."""
    rng = np.random.default_rng(8)
    views = np.column_stack([rng.normal(size=(3, 2)) * 30, np.full(3, 900.0), rng.normal(size=(3, 3)) * 0.1])
    start = poses.inverse(views) if name in ("network", "backward", "part") else views
    part = np.array([[3.0, 2.0, 1.0, 0.1, -0.05, 0.02]])
    shift = np.array([10.0, -20.0, 800.0])
    points = rng.normal(size=(5, 3)) * 150 + (shift if name == "one pose twice" else 0)
    blocks = {
        "points": Block("points", points, ("x", "y", "z"), tuple("abcde")),
        "pose": Block("pose", start, poses.COLUMNS, ("1", "2", "3"), space=Space.POSE),
        "part": Block("part", part, poses.COLUMNS, space=Space.POSE),
        "taper": Block("taper", np.array([[1.0, 2.0, 3.0, 0.01, 0.02, 0.03]]), poses.COLUMNS, space=Space.POSE),
        "coupling": Block("coupling", np.array([[0.05]]), ("gamma_s",)),
        "lens": lens_block(**{**ALL, **dict.fromkeys(RATIONAL, 0.01)}),
    }
    index = {"points": rng.integers(5, size=N), "pose": rng.integers(3, size=N)}
    sigma = rng.uniform(0.1, 2, size=(2, N))
    group = Group("images", Chain(CHAINS[name]), Observations(rng.uniform(500, 1500, (2, N)), sigma, index))
    linear = group.linear(blocks, frozenset(group.chain.blocks))
    assert {touch.block for touch in linear.touches} == set(group.chain.blocks)
    assert np.allclose(linear.residual, group.residuals(blocks) / sigma)
    for touch in linear.touches:
        block = blocks[touch.block]
        for column in range(block.size):
            move = np.zeros(block.values.shape)
            move[:, column] = 1  # each reading sees its own member only
            size = (
                1e-3
                if block.space is Space.POSE and column > 2
                else 1e-3 * max(1.0, np.abs(block.values[:, column]).max())
            )
            expected = differences(
                lambda h, block=block, move=move: group.chain.predict(
                    {**blocks, block.name: block.moved(h * move)}, group.observations
                ),
                size,
            )
            assert close(touch.jacobian[:, column], expected / sigma, 5.0), (touch.block, column)


def test_a_chain_of_single_members_predicts_every_reading() -> None:
    blocks = {
        "points": point_block(1).with_values(np.array([[1.0, 2.0, 900.0]])),
        "lens": lens_block(**ONE_F, **CENTRE),
    }
    chain = Chain((PointOf("points", IN_CAMERA), Lens()))
    predicted = chain.predict(blocks, Observations(np.zeros((2, N)), np.ones(1)))
    assert predicted.shape == (2, N)


def test_chains_refuse_joints_that_do_not_meet() -> None:
    point = PointOf("points", ON_TARGETS)
    with pytest.raises(
        ValueError, match=r"Lens takes a point in the camera, the chain has a point in the frame of the target list"
    ):
        Chain((point, Lens()))
    with pytest.raises(ValueError, match=r"Lens takes a point in the camera, the chain has nothing there"):
        Chain((Lens(),))
    with pytest.raises(ValueError, match=r"PointOf takes nothing, the chain has a point in the part there"):
        Chain((PointOf("part", Quantity.POINT_IN_PART), point))


@dataclass(frozen=True)
class Shifted:
    """An effect that shifts by one."""

    takes: Quantity
    gives: Quantity
    name: str = ""
    blocks: tuple[str, ...] = ()

    def step(self, value: Array, local: LinkContext) -> object:
        raise NotImplementedError


def test_effects_are_put_behind_the_last_link_that_gives_their_quantity() -> None:
    chain = Chain(CHAINS["board"])
    first, second = Shifted(IN_CAMERA, IN_CAMERA, "first"), Shifted(IN_CAMERA, IN_CAMERA, "second")
    on_image = Shifted(Quantity.IMAGE_POINT, Quantity.IMAGE_POINT)
    spliced = chain.spliced([on_image, first, second])
    assert spliced.links == (*chain.links[:2], first, second, chain.links[2], on_image)
    assert chain.spliced([]) == chain


def test_effects_on_parameters_are_put_in_front_of_the_links_that_read_them() -> None:
    chain = Chain(CHAINS["board"])
    assert chain.spliced([Warmer()]).links == (*chain.links[:2], Varied(chain.links[2], "lens", Warmer()))
    assert chain.takes(Warmer()) and not chain.takes(Warmer(varies="tracer"))
    with pytest.raises(ValueError, match="Warmer cannot act here"):
        chain.spliced([Warmer(varies="tracer")])


def test_an_effect_is_given_the_links_before_it() -> None:
    @dataclass(frozen=True)
    class Bound(Shifted):
        before: Chain = Chain(())

        def within(self, before: Chain) -> Bound:
            return replace(self, before=before)

    chain = Chain(CHAINS["board"])
    put = chain.spliced([Bound(IN_CAMERA, IN_CAMERA)]).links[2]
    assert isinstance(put, Bound) and put.before.links == chain.links[:2]


@pytest.mark.parametrize(
    "effect", [Shifted(Quantity.POINT_IN_PART, Quantity.POINT_IN_PART), Shifted(IN_CAMERA, Quantity.IMAGE_POINT)]
)
def test_effects_that_cannot_act_are_refused_in_words(effect: Shifted) -> None:
    with pytest.raises(
        ValueError, match="Shifted cannot act here: the chain passes through point in the frame"
    ) as told:
        Chain(CHAINS["board"]).spliced([effect])
    for quantity in (ON_TARGETS, IN_CAMERA, Quantity.IMAGE_POINT):
        assert quantity.value in str(told.value)


def test_quantities_are_told_apart() -> None:
    values = [quantity.value for quantity in quantities.Quantity]
    assert len(set(values)) == len(values)


def test_a_joint_prior_of_lenses_and_poses_has_the_derivatives_of_its_differences() -> None:
    rng = np.random.default_rng(62)
    lenses, held = lens_blocks(**ONE_F, **CENTRE), pose_block("pose", 4)
    parts = [(lenses, np.array([0, 2, 2]), np.array([0, 0, 1])), (held, np.repeat([1, 3], 6), np.tile(np.arange(6), 2))]
    root = rng.normal(size=(15, 15))
    group = groups.joint_prior(parts, root @ root.T + np.eye(15))
    at = {block.name: block.moved(rng.normal(size=block.values.shape) * 0.1) for block in (lenses, held)}
    linear = group.linear(at, frozenset(at))
    entries = [at[block.name].space.difference(at[block.name].values, block.values)[m, c] for block, m, c in parts]
    off = np.concatenate(entries)
    assert np.isclose(linear.cost, off @ np.linalg.solve(root @ root.T + np.eye(15), off))
    for touch in linear.touches:
        block = at[touch.block]
        for column in range(block.size):
            step = np.zeros(block.values.shape)
            step[touch.index[0], column] = 1.0

            def whitened(size: float, block: Block = block, step: Array = step) -> Array:
                moved = {**at, block.name: block.moved(size * step)}
                return -group.linear(moved, frozenset()).residual[:, 0]

            assert close(touch.jacobian[:, column, 0], differences(whitened, 1e-3), 1.0)
