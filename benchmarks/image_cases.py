"""Image measurements with a hidden effect, simulated by plain formulas that share nothing with the program.

A scene knows its unknowns as a flat vector and gives image points for any of them; effects are formulas of their own.
How strongly an effect shows is found from differences of these image points, not from the program's derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Effects = Mapping[str, Any]
"""Parameters of effects by short names; what is absent is zero"""


def rotation(angles: Array) -> Array:
    """Rz(c) Ry(b) Rx(a), (..., 3) -> (..., 3, 3)."""
    (ca, cb, cc), (sa, sb, sc) = (np.moveaxis(f(angles), -1, 0) for f in (np.cos, np.sin))
    rows = [
        [cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa],
        [sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa],
        [-sb, cb * sa, cb * ca],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


LENS = ("f", "cx", "cy", "k1", "k2", "k3", "p1", "p2", "s1", "s3", "aspect", "skew")


def pixels(points: Array, lens: Mapping[str, Any]) -> Array:
    """Image points (n, 2) of points in the camera (n, 3)."""
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    r2 = x**2 + y**2
    k1, k2, k3, p1, p2, s1, s3 = (lens.get(name, 0.0) for name in LENS[3:10])
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (3 * x**2 + y**2) + s1 * r2
    v = y * radial + 2 * p2 * x * y + p1 * (x**2 + 3 * y**2) + s3 * r2
    wide = lens["f"] * (1 + lens.get("aspect", 0.0))
    return np.column_stack([wide * (u + lens.get("skew", 0.0) * v) + lens["cx"], lens["f"] * v + lens["cy"]])


def ellipse_centres(points: Array, turn: Array, radius: float) -> Array:
    """Points (n, 3) at depth 1 at the centres of the ellipses that circles about `points` project to.

    `turn` (n, 3, 3) has the circle's axes as columns; the conic through five of its projected points gives the centre.
    """
    around = np.arange(5) * (2 * np.pi / 5)
    rim = points[:, None] + radius * (np.cos(around)[:, None] * turn[:, None, :, 0] + np.sin(around)[:, None] * turn[:, None, :, 1])
    plane = points[:, None, :2] / points[:, None, 2:]
    x, y = np.moveaxis((rim[..., :2] / rim[..., 2:] - plane) / (radius / points[:, None, None, 2]), -1, 0)
    rows = np.stack([x * x, x * y, y * y, x, y], axis=-1)
    a, b, c, d, e = np.linalg.solve(rows, np.ones((len(points), 5, 1)))[..., 0].T
    middle = np.column_stack([b * e - 2 * c * d, b * d - 2 * a * e]) / (4 * a * c - b * b)[:, None]
    return np.column_stack([plane[:, 0] + middle * (radius / points[:, 2])[:, None], np.ones(len(points))])


@dataclass(frozen=True)
class Scene:
    """What was measured: which target in which image, when, and where everything truly is."""

    kind: str
    rig: str
    image_size: tuple[int, int]
    noise: float
    targets: Array
    """(m, 3)"""
    images: int
    view: Index
    target: Index
    time: Array
    """(images,) [s]"""
    warmth: Array
    """(images,) [degC]"""
    lens: Mapping[str, float]
    lens_free: tuple[str, ...]
    unknowns: Array
    """Poses and the like, flat"""
    given: Mapping[str, Array] = field(default_factory=dict)
    """spindle (images, 6), mounting (6,)"""
    radius: float = 0.0
    angle_free: bool = True

    @property
    def elapsed(self) -> Array:
        """Time of each reading since the first [s]."""
        return (self.time - self.time.min())[self.view]

    @property
    def warming(self) -> Array:
        """Warmth of each reading against that at the first [K]."""
        return (self.warmth - self.warmth[np.argmin(self.time)])[self.view]

    def only(self, keep: npt.NDArray[np.bool_]) -> Scene:
        """The scene with some of its readings."""
        return replace(self, view=self.view[keep], target=self.target[keep])

    def start(self) -> Array:
        """All unknowns, those of the lens first."""
        return np.concatenate([[self.lens[name] for name in self.lens_free], self.unknowns])

    def predicted(self, unknowns: Array, effects: Effects) -> Array:
        """Image points (n, 2)."""
        k = len(self.lens_free)
        lens: dict[str, Any] = {**self.lens, **dict(zip(self.lens_free, unknowns[:k].tolist(), strict=True))}
        points, turn = (aligned if self.kind == "align-part" else calibrated)(self, unknowns[k:], effects)
        for name in LENS:
            lens[name] = lens.get(name, 0.0) + effects.get(name, 0.0)
        lens["f"] = lens["f"] * (1 + effects.get("focal_t", 0.0) * self.elapsed) * (1 + effects.get("focal_T", 0.0) * self.warming)
        lens["f"] = lens["f"] * (1 + effects.get("ratio", 0.0))
        lens["cx"] = lens["cx"] + effects.get("rate_u", 0.0) * self.elapsed
        lens["cy"] = lens["cy"] + effects.get("rate_v", 0.0) * self.elapsed
        found = pixels(points, lens)
        if "factor" in effects:
            found = found + effects["factor"] * (pixels(ellipse_centres(points, turn, self.radius), lens) - found)
        if "outside" in effects:
            found = found + effects["outside"](self, found - [lens["cx"], lens["cy"]], points) * effects["size"]
        return found

    def listed(self, effects: Effects) -> Array:
        """Each reading's target (n, 3) where it truly is."""
        moved = self.targets * (1 + effects.get("scale", 0.0))
        if "moved" in effects:
            moved = moved.copy()
            moved[effects["target"]] += effects["moved"]
        x, y, _ = moved.T
        bxx, bxy, byy = effects.get("bend", (0.0, 0.0, 0.0))
        bent = moved + np.column_stack([0 * x, 0 * x, bxx * x * x + bxy * x * y + byy * y * y])
        return bent[self.target]


def calibrated(scene: Scene, unknowns: Array, effects: Effects) -> tuple[Array, Array]:
    """Points in the camera and the axes of their circles: a pose for each image (board), or the camera's own (cmm)."""
    points = scene.listed(effects)
    if scene.rig == "board":
        each = unknowns.reshape(-1, 6)[scene.view]
        turn = rotation(each[:, 3:])
        return np.einsum("nab,nb->na", turn, points) + each[:, :3], turn
    turn = rotation(unknowns[3:6])
    back = np.broadcast_to(turn.T, (len(points), 3, 3))
    return (points - unknowns[:3]) @ turn, back


def aligned(scene: Scene, unknowns: Array, effects: Effects) -> tuple[Array, Array]:
    """Points in a camera that the spindle carries, and the axes of their circles (Mendikute et al. eq. 21-22)."""
    spindle = scene.given["spindle"].copy()
    commanded = spindle[:, :3].copy()
    for axis, scale in effects.get("machine_scale", ()):
        spindle[:, axis] += commanded[:, axis] * scale
    for first, second, angle in effects.get("squareness", ()):
        spindle[:, first] += angle * commanded[:, second]
    if "bad_pose" in effects:
        spindle[effects["image"], :3] += effects["bad_pose"]
    mounting = scene.given["mounting"]
    gamma = unknowns[6] if scene.angle_free else effects.get("gamma_s", 0.0)
    clamp = rotation(np.array([0.0, 0.0, -gamma])) @ rotation(np.array([effects.get("alpha_s", 0.0), effects.get("beta_s", 0.0), 0.0]))
    held = rotation(spindle[:, 3:]) @ clamp
    camera = held @ rotation(mounting[3:])
    centre = held @ (mounting[:3] + [effects.get("dx", 0.0), effects.get("dy", 0.0), 0.0]) + spindle[:, :3]
    part = rotation(unknowns[3:6])
    drift = np.asarray(effects.get("drift", np.zeros(3))) * scene.elapsed[:, None]
    machine = scene.listed(effects) @ part.T + unknowns[:3] + drift
    into = np.swapaxes(camera, 1, 2)[scene.view]
    return np.einsum("nab,nb->na", into, machine - centre[scene.view]), into @ part


def strength(scene: Scene, effects: Effects, small: float = 1e-3) -> float:
    """Norm of what the scene's unknowns leave of the effect, over the noise: from differences at a small share of it."""
    start = scene.start()
    plain = scene.predicted(start, {})
    columns = []
    for i, value in enumerate(start):
        step = np.zeros(len(start))
        step[i] = 1e-5 * max(abs(value), 1.0)
        columns.append(((scene.predicted(start + step, {}) - scene.predicted(start - step, {})) / (2 * step[i])).ravel())
    jacobian = np.stack(columns, axis=1)
    jacobian /= np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    q, _ = np.linalg.qr(jacobian)
    signature = ((scene.predicted(start, scaled(effects, small)) - plain) / small).ravel()
    left = signature - q @ (q.T @ signature)
    return float(np.linalg.norm(left - q @ (q.T @ left)) / scene.noise)


def scaled(effects: Effects, share: float) -> dict[str, Any]:
    """The same effects, smaller."""

    def smaller(name: str, value: Any) -> Any:
        if name in ("target", "image", "outside"):
            return value
        if name == "machine_scale":
            return [(axis, share * scale) for axis, scale in value]
        if name == "squareness":
            return [(a, b, share * angle) for a, b, angle in value]
        return share * np.asarray(value) if np.ndim(value) else share * value

    return {name: smaller(name, value) for name, value in effects.items()}


def board_scene(rng: np.random.Generator, views: int = 14) -> Scene:
    """A board of 8 x 10 circles, 25 mm apart, in `views` poses before a camera of 640 x 480 pixels."""
    x, y = np.meshgrid(25.0 * np.arange(10), 25.0 * np.arange(8))
    targets = np.column_stack([x.ravel(), y.ravel(), np.zeros(80)])
    tilt = np.column_stack([rng.uniform(-0.6, 0.6, (views, 2)), rng.uniform(-np.pi, np.pi, views)])
    turn = rotation(np.column_stack([np.zeros((views, 2)), tilt[:, 2]])) @ rotation(tilt * [1, 1, 0])
    away = rng.uniform(330.0, 560.0, views)
    aim = np.column_stack([rng.uniform(-0.12, 0.12, (views, 2)) * away[:, None], away])
    shift = aim - turn @ targets.mean(axis=0)
    poses = np.column_stack([shift, angles(turn)])
    lens = {"f": rng.uniform(780, 820), "cx": rng.uniform(310, 330), "cy": rng.uniform(230, 250), "k1": -0.2, "k2": 0.07}
    return _timed(rng, "calibrate-camera", "board", (640, 480), 0.1, targets, _grid(views, 80), lens, poses.ravel(), 30.0)


def cmm_scene(rng: np.random.Generator, places: int = 120) -> Scene:
    """A target carried to places in five planes before a spindle camera of 2592 x 1944 pixels, seen twice at each."""
    z = rng.choice([395.0, 650.0, 900.0, 1150.0, 1430.0], places)
    targets = np.column_stack([rng.uniform(-0.4, 0.4, places) * z, rng.uniform(-0.3, 0.3, places) * z, z - 320.0])
    lens = {"f": rng.uniform(2780, 2840), "cx": rng.uniform(1270, 1310), "cy": rng.uniform(980, 1010), "k1": 0.2, "k2": -0.1}
    pose = np.array([*rng.normal(0, 3, 2), -320.0, *rng.normal(0, 0.02, 3)])
    order = np.concatenate([rng.permutation(places), rng.permutation(places)])
    index = np.arange(2 * places), order
    return _timed(rng, "calibrate-camera", "cmm", (2592, 1944), 0.05, targets, index, lens, pose, 25.0)


def part_scene(rng: np.random.Generator, images: int = 40, targets: int = 12, turned: bool = True, least: int = 1) -> Scene:
    """A part of 1 m x 0.7 m seen by a camera in the spindle from poses that each show some of its targets."""
    mounting = np.array([*rng.normal(0, 2, 2), -320.0, *rng.normal(0, 0.01, 2), rng.normal(0, 0.03)])
    lens = {"f": rng.uniform(2780, 2840), "cx": rng.uniform(1270, 1310), "cy": rng.uniform(980, 1010), "k1": 0.2, "k2": -0.1}
    points = np.column_stack([rng.uniform(0, 1000, targets), rng.uniform(0, 700, targets), rng.uniform(0, 250, targets)])
    part = np.array([*rng.normal([-700, -350, 200], 40), *rng.normal(0, 0.008, 3)])
    seen_at: list[Array] = []
    while len(seen_at) < images:
        aim = points[(len(seen_at) // 2 if not turned else int(rng.integers(targets))) % targets]
        pose = np.array([*(part[:3] + aim + [0, 0, -rng.uniform(250, 420)] - mounting[:3] + [*rng.uniform(-70, 70, 2), 0]), 0, 0, 0])
        if turned:
            pose[3:] = [*rng.normal(0, 0.03, 2), rng.choice([0, np.pi / 2, np.pi, -np.pi / 2])]
        seen_at.append(pose)
    spindle = np.array(seen_at)
    every = _grid(images, targets)
    known = {"spindle": spindle, "mounting": mounting}
    unknowns = np.concatenate([part, [rng.normal(0, 0.003)]])
    scene = _timed(rng, "align-part", "", (2592, 1944), 0.05, points, every, lens, unknowns, 25.0, known)
    inside = _inside(scene)
    enough = np.bincount(scene.view, inside, minlength=images) >= least
    return part_scene(rng, images, targets, turned, least) if not enough.all() else scene.only(inside)


def _grid(images: int, targets: int) -> tuple[Index, Index]:
    return np.repeat(np.arange(images), targets), np.tile(np.arange(targets), images)


def _timed(
    rng: np.random.Generator, kind: str, rig: str, size: tuple[int, int], noise: float, targets: Array,
    index: tuple[Index, Index], lens: Mapping[str, float], unknowns: Array, interval: float, given: Mapping[str, Array] | None = None,
) -> Scene:  # fmt: skip
    images = int(index[0].max()) + 1
    time = interval * np.arange(images) + rng.uniform(0, 0.2 * interval, images)
    wave = np.cumsum(rng.normal(0, 0.3 / np.sqrt(images), images))
    warmth = 20 + wave + 0.8 * np.sin(rng.uniform(0, 6) + 2.5 * time / time[-1])
    lens = dict(lens) | {"p1": rng.normal(0, 4e-4), "p2": rng.normal(0, 4e-4)}
    free = () if kind == "align-part" else tuple(lens)
    scene = Scene(kind, rig, size, noise, targets, images, *index, time, warmth, lens, free, unknowns, given or {}, 4.0)
    return scene if kind == "align-part" else scene.only(_inside(scene))


def _inside(scene: Scene) -> npt.NDArray[np.bool_]:
    points, _ = (aligned if scene.kind == "align-part" else calibrated)(scene, scene.unknowns, {})
    uv = scene.predicted(scene.start(), {})
    near = np.hypot(*(points[:, :2] / np.where(points[:, 2:] > 0, points[:, 2:], 1e9)).T) < 0.7
    return np.asarray((points[:, 2] > 0) & near & ((uv > 5) & (uv < np.array(scene.image_size) - 6)).all(axis=1))


def angles(turn: Array) -> Array:
    """Angles (a, b, c) of rotations (..., 3, 3)."""
    return np.stack(
        [np.arctan2(turn[..., 2, 1], turn[..., 2, 2]), -np.arcsin(turn[..., 2, 0]), np.arctan2(turn[..., 1, 0], turn[..., 0, 0])], axis=-1
    )
