"""Small adjustments of every make, with noise of their own and starting values away from the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from simulated.camera import LENS, SIZE, Seen, board, look

from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group, joint_prior, prior
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import Quantity
from metrocli.geometry import poses
from metrocli.instruments import camera, spindle_camera
from metrocli.instruments.frames import DistanceBetween, FromFrame, PointOf

Array = npt.NDArray[np.float64]
NOISE = 0.1
PARAMETERS = tuple(LENS)


@dataclass(frozen=True)
class Problem:
    """Blocks at starting values with their groups."""

    blocks: Mapping[str, Block]
    groups: tuple[Group, ...]
    datum: Datum | None = None

    def with_blocks(self, *blocks: Block) -> Problem:
        """The problem with some blocks put in the place of those of their name."""
        return replace(self, blocks={**self.blocks, **{block.name: block for block in blocks}})

    def with_groups(self, *groups: Group) -> Problem:
        """The problem with more groups."""
        return replace(self, groups=(*self.groups, *groups))


def names(prefix: str, count: int) -> tuple[str, ...]:
    return tuple(f"{prefix}{i + 1}" for i in range(count))


def off(block: Block, seed: int, amount: float = 0.01) -> Block:
    """The block moved at random by a share of its reach where it is free."""
    rng = np.random.default_rng(seed)
    reach = np.where(np.isfinite(block.reach), block.reach, 0.3)
    return block.moved(np.where(block.free, rng.normal(size=block.values.shape) * amount * reach, 0.0))


def lens(free: tuple[str, ...] = PARAMETERS) -> Block:
    return camera.lens_block(LENS, free, SIZE)


def images(seen: Seen, chain: Chain, sigma: Array | float = NOISE) -> Group:
    index = {camera.TARGET: seen.target, camera.VIEW: seen.view, spindle_camera.SPINDLE: seen.view}
    index = {name: places for name, places in index.items() if name in chain.blocks}
    return Group("images", chain, Observations(seen.uv, np.asarray(sigma), index, components=("u", "v"), unit="px"))


def targets(seen: Seen, free: Array | bool = False) -> Block:
    extent = float(np.ptp(seen.points, axis=0).max())
    return camera.target_block(seen.points, names("T", len(seen.points)), free, extent)


def board_camera(views: int = 8, seed: int = 1, points: Array | None = None, noise: float = NOISE) -> Problem:
    """A lens and the poses of a flat board."""
    seen = look(board(5, 4) if points is None else points, views, seed).noisy(noise, seed + 1)
    poses_of = camera.view_block(seen.poses, names("view", views), 700.0)
    blocks = [off(lens(), 3), off(poses_of, 4), targets(seen)]
    return Problem({b.name: b for b in blocks}, (images(seen, camera.chain("board", "forward")),))


CUBE = np.random.default_rng(77).uniform(-150, 150, (24, 3))


def network(views: int = 7, seed: int = 5, free: Array | bool = True, points: Array = CUBE) -> Problem:
    """A lens, camera poses, and targets in space; the datum is left to the caller."""
    seen = look(points, views, seed, tilt=70).noisy(NOISE, seed + 1)
    stations = camera.view_block(poses.inverse(seen.poses), names("view", views), 700.0)
    blocks = [off(lens(), 3), off(stations, 4), off(targets(seen, free), 6)]
    return Problem({b.name: b for b in blocks}, (images(seen, camera.chain("network", "forward")),))


def with_control(control: int = 4, **keys: int) -> Problem:
    """A network held by targets that are known."""
    free = np.ones((len(CUBE), 1), dtype=bool)
    free[:control] = False
    return network(free=free, **keys)


def scale_bars(problem: Problem, bars: int = 4, seed: int = 9, sigma: float = 0.02) -> Group:
    rng = np.random.default_rng(seed)
    index = np.stack([np.arange(bars), np.arange(bars) + bars])
    truth = np.linalg.norm(CUBE[index[0]] - CUBE[index[1]], axis=1)
    observed = Observations((truth + sigma * rng.normal(size=bars))[None], np.array(sigma), {camera.TARGET: index})
    return Group("scale bars", Chain((DistanceBetween(camera.TARGET),)), observed)


def few_views_many_targets() -> Problem:
    """More unknowns in the targets than in the views: the targets are eliminated, some of them in part fixed."""
    points = np.random.default_rng(78).uniform(-150, 150, (30, 3))
    free = np.ones((30, 3), dtype=bool)
    free[:4] = False
    free[4:9] = [True, False, True]
    return network(views=6, seed=12, free=free, points=points)


def fixed_in_part() -> Problem:
    """Poses eliminated, of which some keep their height and some a turn."""
    problem = board_camera()
    free = np.ones((8, 6), dtype=bool)
    free[2, 2], free[5, 3:] = False, False
    truth = look(board(5, 4), 8, 1).poses
    views = problem.blocks[camera.VIEW]
    values = np.where(free.all(axis=1)[:, None], views.values, truth)
    return problem.with_blocks(replace(views, free=free, values=values))


def a_covariance(sigma: Array, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(len(sigma),) * 2))[0]
    correlation = turn @ np.diag(rng.uniform(0.3, 2, len(sigma))) @ turn.T
    covariance: Array = correlation * sigma[:, None] * sigma
    return covariance


def correlated() -> Problem:
    """u and v of a reading correlated, each reading in its own way."""
    problem = board_camera(seed=21)
    group = problem.groups[0]
    n = group.observations.count
    covariance = np.stack([a_covariance(np.array([0.1, 0.2]), i) for i in range(n)], axis=-1)
    return replace(problem, groups=(group.with_observations(replace(group.observations, covariance=covariance)),))


def priors() -> Problem:
    """Priors on some views, one of them with full covariance, on some columns of the lens, on targets that are seen."""
    problem = board_camera(views=7, seed=31)
    truth = look(board(5, 4), 7, 31).poses
    views = problem.blocks[camera.VIEW]
    known = views.with_values(truth)
    height = prior(known, np.array([1, 4]), sigma=np.array([[0.5, 0.001], [0.7, 0.002]]), columns=(2, 4))
    whole = prior(known, np.array([6]), covariance=a_covariance(np.array([0.2, 0.2, 0.5, 1e-3, 1e-3, 1e-3]), 2))
    centre = prior(lens(), np.array([0]), sigma=np.array([[2.0, 1.0]]), columns=(1, 2))
    free = replace(problem.blocks[camera.TARGET], free=np.array(True))
    measured = prior(free, np.arange(20), sigma=np.full((20, 3), 0.02))
    return problem.with_blocks(free).with_groups(height, whole, centre, measured)


def weighted() -> Problem:
    """Robust weights between 0 and 1 on the readings, different sigma on each component."""
    problem = board_camera(seed=41)
    rng = np.random.default_rng(3)
    group = problem.groups[0]
    sigma = rng.uniform(0.05, 0.3, group.observations.readings.shape)
    group = group.with_observations(replace(group.observations, sigma=sigma))
    return replace(problem, groups=(replace(group, weights=rng.uniform(1e-3, 1, group.observations.count)),))


def taper(seed: int = 51) -> Problem:
    """One pose of the camera, targets with priors, a joint prior of lens and pose."""
    problem = network(views=1, seed=seed)
    station = problem.blocks[camera.VIEW]
    pose = Block(camera.TAPER, station.values, poses.COLUMNS, reach=station.reach, space=station.space)
    group = images(look(CUBE, 1, seed, tilt=70).noisy(NOISE, seed + 1), camera.chain("cmm", "forward"))
    truth = replace(problem.blocks[camera.TARGET], values=CUBE)
    measured = prior(truth, np.arange(len(CUBE)), sigma=np.full((len(CUBE), 3), 0.05))
    sigma = np.array([20.0, 5, 5, 0.05, 0.3, 1e-3, 1e-3, 2, 2, 5, 0.01, 0.01, 0.01])
    shape = replace(pose, values=poses.inverse(look(CUBE, 1, seed, tilt=70).poses))
    parts = [(block, np.zeros(k, dtype=np.intp), np.arange(k)) for block, k in ((lens(), 7), (shape, 6))]
    joint = joint_prior(parts, a_covariance(sigma, 8))
    blocks = [problem.blocks[camera.LENS], pose, problem.blocks[camera.TARGET]]
    return Problem({b.name: b for b in blocks}, (group, measured, joint))


def part_in_machine() -> Problem:
    """The part's pose and the clamping angle; lens and camera pose are known."""
    rng = np.random.default_rng(71)
    held = np.array([[5.0, -3.0, 120.0, 0.02, -0.01, 0.03]])
    turn = poses.pose_from_euler(np.zeros(3), np.array([0.0, 0.0, -0.002]))
    spindle = np.column_stack([rng.uniform(-300, 300, (9, 2)), np.full(9, 900.0), np.tile([np.pi, 0, 0], (9, 1))])
    spindle[:, 3:] += rng.normal(size=(9, 3)) * 0.3
    part = np.array([[10.0, 20.0, 30.0, 0.03, -0.02, 0.5]])
    chain = spindle_camera.chain("forward")
    points = np.array([[-300.0, -200, 0], [300, -200, 10], [300, 200, 0], [-300, 200, 50], [0, 0, 20]])
    blocks = {
        "target": camera.target_block(points, names("T", 5), False, 600.0),
        "part": spindle_camera.part_block(part, 600.0, 900.0),
        "spindle": spindle_camera.spindle_block(spindle, names("view", 9)),
        "coupling": spindle_camera.coupling_block(-turn[5], True),
        "camera": Block(
            "camera",
            held,
            poses.COLUMNS,
            free=np.array(False),
            reach=np.array([300.0] * 3 + [0.5] * 3),
            space=camera.Space.POSE,
        ),
        "lens": lens().fixed(),
    }
    m = len(points)
    seen = Seen(points, spindle, spindle, np.zeros((2, 9 * m)), np.tile(np.arange(m), 9), np.repeat(np.arange(9), m))
    group = images(seen, chain)
    exact = chain.predict(blocks, group.observations)
    noisy = group.with_observations(group.observations.with_readings(exact + NOISE * rng.normal(size=exact.shape)))
    blocks = {**blocks, "part": off(blocks["part"], 1), "coupling": off(blocks["coupling"], 2)}
    return Problem(blocks, (noisy,))


def one_frame_of_points() -> Problem:
    """Points measured directly in a shifted frame, three components correlated: linear but for the turn, nothing eliminated."""
    rng = np.random.default_rng(91)
    points = rng.uniform(-500, 500, (12, 3))
    pose = np.array([[100.0, 200, -50, 0.3, 0.2, -0.1]])
    chain = Chain(
        (
            PointOf("target", Quantity.POINT_IN_PART),
            FromFrame("part", Quantity.POINT_IN_PART, Quantity.POINT_IN_MACHINE),
        )
    )
    readings = poses.apply(pose, points).T + 0.01 * rng.normal(size=(3, 12))
    covariance = np.stack([a_covariance(np.full(3, 0.01), i) for i in range(12)], axis=-1)
    observed = Observations(readings, np.ones(1), {"target": np.arange(12)}, covariance=covariance)
    blocks = [
        camera.target_block(points, names("T", 12), False, 1000.0),
        off(spindle_camera.part_block(pose, 1000.0, 1000.0), 3),
    ]
    return Problem({b.name: b for b in blocks}, (Group("points", chain, observed),))


def with_scale_bars() -> Problem:
    problem = with_control()
    return problem.with_groups(scale_bars(problem))


PROBLEMS = {
    "views eliminated": board_camera,
    "targets eliminated, in part fixed": few_views_many_targets,
    "control points": with_control,
    "views fixed in part": fixed_in_part,
    "correlated readings": correlated,
    "priors": priors,
    "robust weights": weighted,
    "joint prior": taper,
    "scale bars": with_scale_bars,
    "nothing eliminated": one_frame_of_points,
    "part in the machine": part_in_machine,
}
