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
    across, along = turn[:, None, :, 0], turn[:, None, :, 1]
    rim = points[:, None] + radius * (np.cos(around)[:, None] * across + np.sin(around)[:, None] * along)
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
    view: Index
    target: Index
    lens: Mapping[str, float]
    unknowns: Array
    """Poses and the like, flat"""
    lens_free: tuple[str, ...] = ()
    given: Mapping[str, Array] = field(default_factory=dict)
    """spindle (images, 6), mounting (6,)"""
    radius: float = 0.0
    angle_free: bool = True
    rolling: bool = False
    """Whether the rows of an image are read one after another, which the job knows"""
    time: Array = field(default_factory=lambda: np.zeros(0))
    """(images,) [s]"""
    warmth: Array = field(default_factory=lambda: np.zeros(0))
    """(images,) [degC]"""

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

    def with_lens(self, rng: np.random.Generator) -> Scene:
        """The scene with a principal point and decentring drawn at random, all lens parameters unknown."""
        lens = dict(self.lens)
        lens |= {"cx": lens["cx"] + rng.uniform(-12, 12), "cy": lens["cy"] + rng.uniform(-12, 12)}
        lens |= {"p1": rng.normal(0, 4e-4), "p2": rng.normal(0, 4e-4)}
        return replace(self, lens=lens, lens_free=tuple(lens))

    def without(self, names: tuple[str, ...]) -> Scene:
        """The scene with lens parameters that the job takes as known: no distortion, the middle of the image."""
        middle = {"cx": (self.image_size[0] - 1) / 2, "cy": (self.image_size[1] - 1) / 2}
        lens = {**self.lens, **{name: middle.get(name, 0.0) for name in names}}
        return replace(self, lens=lens, lens_free=tuple(name for name in self.lens_free if name not in names))

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
        grown = effects.get("focal_t", 0.0) * self.elapsed + effects.get("focal_T", 0.0) * self.warming
        lens["f"] = lens["f"] * (1 + grown + effects.get("ratio", 0.0))
        lens["cx"] = lens["cx"] + effects.get("rate_u", 0.0) * self.elapsed
        lens["cy"] = lens["cy"] + effects.get("rate_v", 0.0) * self.elapsed
        found = pixels(points, lens)
        if "factor" in effects:
            found = found + effects["factor"] * (pixels(ellipse_centres(points, turn, self.radius), lens) - found)
        if "rolling" in effects:
            below = (found[:, 1] - lens["cy"]) * (self.view == effects["image"])
            found = found + below[:, None] * effects["rolling"][:2]
        if "outside" in effects:
            off = found - np.column_stack([lens["cx"], lens["cy"]])
            found = found + effects["size"] * effects["outside"](self, off, points)
        return found

    def listed(self, effects: Effects) -> Array:
        """Each reading's target (n, 3) where it truly is."""
        moved = self.targets * (1 + effects.get("scale", 0.0))
        if "stretched" in effects:
            moved = moved.copy()
            moved[:, 0] += moved[:, :2] @ effects["stretched"][:2]
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
    if "bow" in effects:
        i, along = effects["axis"], commanded[:, effects["axis"]]
        arc = (along - (along.min() + along.max()) / 2) ** 2
        spindle[:, (i + 1) % 3] += effects["bow"][0] * arc
        spindle[:, (i + 2) % 3] += effects["bow"][1] * arc
    if "bad_pose" in effects:
        spindle[effects["image"], :3] += effects["bad_pose"]
    turn = rotation(spindle[:, 3:])
    if "angular" in effects:
        along = commanded[:, effects["axis"]]
        turned = np.outer(along - (along.min() + along.max()) / 2, effects["angular"])
        turn = rotation(turned) @ turn
    grown = effects.get("growth", 0.0) * (scene.time - scene.time.min(initial=np.inf))
    spindle[:, :3] += turn[:, :, 2] * grown[:, None]
    mounting = scene.given["mounting"]
    gamma = unknowns[6] if scene.angle_free else effects.get("gamma_s", 0.0)
    tilt = np.array([effects.get("alpha_s", 0.0), effects.get("beta_s", 0.0), 0.0])
    clamp = rotation(np.array([0.0, 0.0, -gamma])) @ rotation(tilt)
    held = turn @ clamp
    camera = held @ rotation(mounting[3:])
    centre = held @ (mounting[:3] + [effects.get("dx", 0.0), effects.get("dy", 0.0), 0.0]) + spindle[:, :3]
    part = rotation(unknowns[3:6])
    drift = np.asarray(effects.get("drift", np.zeros(3))) * scene.elapsed[:, None]
    machine = scene.listed(effects) @ part.T + unknowns[:3] + drift
    into = np.swapaxes(camera, 1, 2)[scene.view]
    return np.einsum("nab,nb->na", into, machine - centre[scene.view]), into @ part


@dataclass(frozen=True)
class Sight:
    """What of a change of the image points the unknowns of a scene leave, from differences of its image points."""

    scene: Scene
    taken: Array
    """Orthonormal basis of what the unknowns can do, (coordinates, unknowns)"""

    def strength(self, effects: Effects, small: float = 1e-3) -> float:
        """Norm of what is left of an effect, over the noise: from differences at a small share of it."""
        return float(np.linalg.norm(self.left(effects, small)) / self.scene.noise)

    def left(self, effects: Effects, small: float = 1e-3) -> Array:
        """What is left of an effect, (coordinates,)."""
        start = self.scene.start()
        change = self.scene.predicted(start, scaled(effects, small)) - self.scene.predicted(start, {})
        signature = (change / small).ravel()
        seen = signature - self.taken @ (self.taken.T @ signature)
        return np.asarray(seen - self.taken @ (self.taken.T @ seen))


def sight(scene: Scene) -> Sight:
    """What the unknowns of a scene take in of its image points."""
    start = scene.start()
    columns = []
    for i, value in enumerate(start):
        step = np.zeros(len(start))
        step[i] = 1e-5 * max(abs(value), 1.0)
        columns.append((scene.predicted(start + step, {}) - scene.predicted(start - step, {})).ravel())
    jacobian = np.stack(columns, axis=1)
    taken, _ = np.linalg.qr(jacobian / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300))
    return Sight(scene, taken)


def scaled(effects: Effects, share: float) -> dict[str, Any]:
    """The same effects, smaller."""

    def smaller(name: str, value: Any) -> Any:
        if name in ("target", "image", "axis", "outside"):
            return value
        if name == "machine_scale":
            return [(axis, share * scale) for axis, scale in value]
        if name == "squareness":
            return [(a, b, share * angle) for a, b, angle in value]
        return share * np.asarray(value) if np.ndim(value) else share * value

    return {name: smaller(name, value) for name, value in effects.items()}


def board_scene(rng: np.random.Generator, views: int = 14, size: tuple[int, int] = (10, 8)) -> Scene:
    """A board of circles, 25 mm apart, in `views` poses before a camera of 640 x 480 pixels."""
    x, y = np.meshgrid(25.0 * np.arange(size[0]), 25.0 * np.arange(size[1]))
    targets = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    tilt, roll = rng.uniform(-0.6, 0.6, (views, 2)), rng.uniform(-np.pi, np.pi, views)
    flat, none = np.zeros((views, 2)), np.zeros(views)
    turn = rotation(np.column_stack([flat, roll])) @ rotation(np.column_stack([tilt, none]))
    away = rng.uniform(330.0, 560.0, views) * max(size) / 10
    shift = np.column_stack([rng.uniform(-0.12, 0.12, (views, 2)) * away[:, None], away]) - turn @ targets.mean(axis=0)
    poses = np.column_stack([shift, angles(turn)]).ravel()
    lens = {"f": rng.uniform(780, 820), "cx": 319.5, "cy": 239.5, "k1": -0.2, "k2": 0.07}
    index = np.repeat(np.arange(views), x.size), np.tile(np.arange(x.size), views)
    blank = Scene("calibrate-camera", "board", (640, 480), 0.1, targets, *index, lens, poses, radius=10.0)
    return timed(blank.with_lens(rng), rng, 30.0)


def cmm_scene(rng: np.random.Generator, places: int = 120) -> Scene:
    """A target carried to places in five planes before a spindle camera of 2592 x 1944 pixels, seen twice at each."""
    z = rng.choice([395.0, 650.0, 900.0, 1150.0, 1430.0], places)
    targets = np.column_stack([rng.uniform(-0.4, 0.4, places) * z, rng.uniform(-0.3, 0.3, places) * z, z - 320.0])
    lens = {"f": rng.uniform(2780, 2840), "cx": 1295.5, "cy": 971.5, "k1": 0.2, "k2": -0.1}
    pose = np.array([*rng.normal(0, 3, 2), -320.0, *rng.normal(0, 0.02, 3)])
    index = np.arange(2 * places), np.concatenate([rng.permutation(places), rng.permutation(places)])
    blank = Scene("calibrate-camera", "cmm", (2592, 1944), 0.05, targets, *index, lens, pose, radius=3.0)
    return timed(blank.with_lens(rng), rng, 25.0)


def part_scene(rng: np.random.Generator, images: int = 40, targets: int = 12, turned: bool = True) -> Scene:
    """A part of 1 m x 0.7 m seen by a camera in the spindle from poses that each show some of its targets.

    Turned: in any order and with the spindle at four angles; else each target in two images that follow each other.
    """
    mounting = np.array([*rng.normal(0, 2, 2), -320.0, *rng.normal(0, 0.01, 2), rng.normal(0, 0.03)])
    lens = {"f": rng.uniform(2780, 2840), "cx": 1290.0, "cy": 990.0, "k1": 0.2, "k2": -0.1, "p1": -2e-4, "p2": 9e-4}
    points = rng.uniform(0, 1, (targets, 3)) * [1000, 700, 250]
    part = np.array([*rng.normal([-500, -350, 200], 40), *rng.normal(0, 0.008, 3)])
    aim = points[rng.integers(targets, size=images) if turned else np.arange(images) // 2 % targets]
    away = np.column_stack([rng.uniform(-70, 70, (images, 2)), -rng.uniform(250, 420, images)])
    spindle = np.column_stack([part[:3] + aim + away - mounting[:3], np.zeros((images, 3))])
    if turned:
        spindle[:, 3:5] = rng.normal(0, 0.03, (images, 2))
        spindle[:, 5] = rng.choice([0, np.pi / 2, np.pi, -np.pi / 2], images)
    index = np.repeat(np.arange(images), targets), np.tile(np.arange(targets), images)
    unknowns = np.concatenate([part, [rng.normal(0, 0.003)]])
    given = {"spindle": spindle, "mounting": mounting}
    blank = Scene("align-part", "", (2592, 1944), 0.05, points, *index, lens, unknowns, (), given, 6.0)
    return timed(blank, rng, 25.0)


def timed(scene: Scene, rng: np.random.Generator, interval: float) -> Scene:
    """The scene with times and temperatures of its images, and with the readings that lie inside its images."""
    images = int(scene.view.max()) + 1
    time = interval * np.arange(images) + rng.uniform(0, 0.2 * interval, images)
    swing = 0.8 * np.sin(rng.uniform(0, 6) + 2.5 * time / time[-1])
    warmth = 20 + np.cumsum(rng.normal(0, 0.3 / np.sqrt(images), images)) + swing
    scene = replace(scene, time=time, warmth=warmth)
    return scene.only(_inside(scene))


def _inside(scene: Scene) -> npt.NDArray[np.bool_]:
    points, _ = (aligned if scene.kind == "align-part" else calibrated)(scene, scene.unknowns, {})
    uv = scene.predicted(scene.start(), {})
    near = np.hypot(*(points[:, :2] / np.where(points[:, 2:] > 0, points[:, 2:], 1e9)).T) < 0.7
    return np.asarray((points[:, 2] > 0) & near & ((uv > 5) & (uv < np.array(scene.image_size) - 6)).all(axis=1))


def angles(turn: Array) -> Array:
    """Angles (a, b, c) of rotations (..., 3, 3)."""
    a, b = np.arctan2(turn[..., 2, 1], turn[..., 2, 2]), -np.arcsin(turn[..., 2, 0])
    return np.stack([a, b, np.arctan2(turn[..., 1, 0], turn[..., 0, 0])], axis=-1)
